"""All fast code, one public function per operation.

`splat`, `motion` and `adam` take tensors on any device. `image`, `carve`, `translation`, `rigid` and `sceneflow` take numpy
arrays.
"""
