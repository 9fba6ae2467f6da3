"""File formats of Gaussians, one file per format with its reader and its writer."""
