"""All fast code, behind one signature each: `splat`, `motion`, `adam`, `image`, `carve`, `translation`, `rigid` and `sceneflow`."""
