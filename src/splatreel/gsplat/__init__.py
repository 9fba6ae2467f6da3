"""Training with the kernels of gsplat on CUDA: programs with torch's autograd inside. Only `run.device_choice` imports this room."""
