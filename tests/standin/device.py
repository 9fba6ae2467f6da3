"""Simulated CUDA tensors.

A simulated tensor wraps a tensor on the CPU. Conversion to numpy, and operations together with CPU tensors, fail as they do on a GPU.
Operations that wait for the device (`item`, `nonzero`, masks as indices) are counted. Only Python code sees a CUDA device. For autograd
the tensors are on the CPU, because its engine would need a real device.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map

WAITS = Counter[str]()
"""Number of waits for the device, for each operation."""
_WAITING = {"aten::_local_scalar_dense": "item", "aten::nonzero": "nonzero"}
_PULLS = {"aten::index", "aten::index_put_", "aten::_index_put_impl_"}
"""Operations whose indices may be on the CPU."""
_ON_CPU = (Tensor.numpy, Tensor.__array__, Tensor.data_ptr)


class Remote(Tensor):
    """A simulated CUDA tensor. held: the wrapped tensor on the CPU."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> Remote:
        assert type(held) is Tensor
        shape = {"strides": held.stride(), "storage_offset": held.storage_offset(), "dtype": held.dtype}
        return Tensor._make_wrapper_subclass(cls, held.size(), **shape)  # pyright: ignore[reportAttributeAccessIssue]

    def __init__(self, held: Tensor) -> None:
        self.held = held

    def __repr__(self, *, tensor_contents: Any = None) -> str:
        return f"Remote({self.held})"

    @classmethod
    def __torch_function__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func == Tensor.is_cuda.__get__:  # pyright: ignore[reportAttributeAccessIssue]
            return True
        if func == Tensor.device.__get__:  # pyright: ignore[reportAttributeAccessIssue]
            return torch.device("cuda", 0)
        if func in _ON_CPU:
            raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu() first.")
        if func in (Tensor.to, Tensor.cpu, Tensor.cuda):
            return _moved(func, *args, **kwargs)
        if kwargs.get("device") is not None:
            kwargs["device"] = "cpu"  # for new tensors like this one; __torch_dispatch__ wraps the result
        with torch._C.DisableTorchFunctionSubclass():
            return func(*args, **kwargs)

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs, name = kwargs or {}, func._schema.name
        _meet(name, args, kwargs)
        result = func(*tree_map(held, args), **tree_map(held, kwargs))
        if func._schema.is_mutable:  # in place: return the same wrapper
            return None if result is None else kwargs.get("out", args[0])
        return tree_map(lambda value: Remote(value) if type(value) is Tensor else value, result)


def held(value: Any) -> Any:
    """Return the tensor that a remote tensor wraps. Return other values unchanged."""
    return value.held if isinstance(value, Remote) else value


def _meet(name: str, args: Any, kwargs: Any) -> None:
    """Raise RuntimeError if an operation mixes tensors of two devices, and count waits for the device."""
    tensors = [value for value in tree_leaves((args, kwargs)) if isinstance(value, Tensor)]
    near = [tensor for tensor in tensors if not isinstance(tensor, Remote) and tensor.dim()]
    if name == "aten::stack":
        # For parts of `unbind` without a gradient, autograd makes zeros on the CPU, where it takes the other parts to be.
        near = [tensor for tensor in near if tensor.any()]
    pulls = name in _PULLS and isinstance(args[0], Remote)
    if near and not pulls and name != "aten::copy_":
        raise RuntimeError(f"Expected all tensors to be on the same device: {name} of {[t.shape for t in near]}")
    masks = name == "aten::index" and any(isinstance(t, Remote) and t.dtype == torch.bool for t in tree_leaves(args[1]))
    if name in _WAITING or masks:
        WAITS[_WAITING.get(name, "mask")] += 1


class _Up(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, tensor: Tensor) -> Tensor:
        return Remote(tensor.detach().clone())

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        return held(gradients[0]).clone()


class _Down(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, tensor: Tensor) -> Tensor:
        return held(tensor).clone()

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        return Remote(gradients[0])


def _moved(func: Any, tensor: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    """Run `to`, `cpu` or `cuda` between the CPU and the simulated device."""
    dtype, device = kwargs.get("dtype"), kwargs.get("device")
    device = {Tensor.cpu: "cpu", Tensor.cuda: "cuda"}.get(func, device)
    for value in args:
        if isinstance(value, Tensor):
            dtype, device = value.dtype, value.device
        elif isinstance(value, torch.dtype):
            dtype = value
        elif isinstance(value, (str, torch.device)):
            device = value
    if dtype is not None and dtype != tensor.dtype:
        with torch._C.DisableTorchFunctionSubclass():
            tensor = Tensor.to(tensor, dtype)
    if device is None or (torch.device(device).type == "cuda") == isinstance(tensor, Remote):
        return tensor
    if isinstance(tensor, Remote):
        WAITS["cpu"] += 1
        return _Down.apply(tensor)  # pyright: ignore[reportReturnType]
    return _Up.apply(tensor)  # pyright: ignore[reportReturnType]


class Asked(TorchFunctionMode):
    """Mode in which tensors that are created on CUDA or moved to CUDA become remote tensors."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        wanted = [kwargs.get("device"), *(args[1:] if func is Tensor.to else ())]
        devices = [torch.device(value) for value in wanted if isinstance(value, (str, torch.device))]
        on_cuda = func is Tensor.cuda or any(device.type == "cuda" for device in devices)
        to_remote = func is Tensor.to and any(isinstance(value, Remote) for value in args)
        if func in (Tensor.to, Tensor.cuda) and (on_cuda or to_remote):
            return _moved(func, *args, **kwargs)
        if func in (torch.as_tensor, torch.tensor) and args and isinstance(args[0], Tensor):
            return _moved(Tensor.to, *args, **kwargs)
        if on_cuda and not any(isinstance(value, Remote) for value in args):
            kwargs["device"], leaf = "cpu", kwargs.pop("requires_grad", False)
            return Remote(func(*args, **kwargs)).requires_grad_(leaf)
        return func(*args, **kwargs)
