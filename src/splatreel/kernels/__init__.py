"""All fast code: projection, spherical harmonics, rasterisation, losses, hash grid, nearest neighbours."""
