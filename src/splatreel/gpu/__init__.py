"""Training on any GPU through WebGPU (wgpu): kernels in WGSL, and the programs that run whole iterations on the device."""
