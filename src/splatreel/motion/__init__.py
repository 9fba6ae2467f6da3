"""Motion in images: optical flow, masks, tracks, new points, exposure and light."""
