"""The word "cuda" means the CPU: tensors, modules, streams, events, memory queries, loaders and files.

Differences from a machine with CUDA: `.cuda()` and `.to("cuda")` of a tensor return that tensor, never a copy of
it, so writing into the result writes into the tensor (there it may be a copy); half precision under autocast stays off.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import psutil
import torch
from torch.overrides import TorchFunctionMode
from torch.utils.data import DataLoader

CPU = torch.device("cpu")


class CpuForCuda(TorchFunctionMode):
    """While active, every PyTorch call that names a CUDA device is done on the CPU.

    Attributes:
        on_backward: called with the loss, a number, before every `loss.backward()`.
    """

    def __init__(self, on_backward: Callable[[float], None] | None = None):
        super().__init__()
        self.on_backward = on_backward

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = {} if kwargs is None else kwargs
        if func is torch.Tensor.cuda or func is torch.Tensor.pin_memory:
            return args[0]
        if func is torch.Tensor.backward and self.on_backward is not None and args[0].numel() == 1:
            self.on_backward(float(args[0].detach()))
        if kwargs.get("device") is not None:
            kwargs = kwargs | {"device": on_cpu_device(kwargs["device"])}
        if func is torch.Tensor.to:
            args = (args[0], *(on_cpu_device(value) for value in args[1:]))
        elif func is torch.Tensor.type and len(args) > 1 and isinstance(args[1], str):
            args = (args[0], args[1].replace("torch.cuda.", "torch."), *args[2:])
        return func(*args, **kwargs)


def on_cpu_device(device: Any) -> Any:
    """Return a device, its name or its number as the CPU; everything else unchanged."""
    if isinstance(device, bool):
        return device
    if isinstance(device, int):
        return CPU
    if isinstance(device, str):
        return CPU if device.partition(":")[0] == "cuda" else device
    return CPU if isinstance(device, torch.device) and device.type == "cuda" else device


class Event:
    """`torch.cuda.Event` by the clock of the process: work is done when the call returns."""

    def __init__(self, enable_timing=False, blocking=False, interprocess=False):
        self._at = time.perf_counter()

    def record(self, stream=None):
        self._at = time.perf_counter()

    def elapsed_time(self, end_event: Event) -> float:
        """Return milliseconds until `end_event`."""
        return 1e3 * (end_event._at - self._at)

    def synchronize(self):
        pass

    def wait(self, stream=None):
        pass

    def query(self) -> bool:
        return True


class Stream:
    """`torch.cuda.Stream`: there is one order of work."""

    def __init__(self, device=None, priority=0):
        pass

    def synchronize(self):
        pass

    def wait_stream(self, stream):
        pass

    def wait_event(self, event):
        pass

    def record_event(self, event=None) -> Event:
        return event or Event()


def _nothing(*args, **kwargs) -> None:
    pass


def _used_bytes(device=None) -> int:
    return psutil.Process().memory_info().rss


def _free_and_all_bytes(device=None) -> tuple[int, int]:
    memory = psutil.virtual_memory()
    return memory.available, memory.total


def _properties(device=None) -> SimpleNamespace:
    return SimpleNamespace(name="CPU", total_memory=psutil.virtual_memory().total, major=0, minor=0)


CUDA = {
    "is_available": lambda: True,
    "is_initialized": lambda: True,
    "init": _nothing,
    "device_count": lambda: 1,
    "current_device": lambda: 0,
    "set_device": _nothing,
    "device": lambda device=None: nullcontext(),
    "get_device_name": lambda device=None: "CPU",
    "get_device_properties": _properties,
    "get_device_capability": lambda device=None: (0, 0),
    "synchronize": _nothing,
    "empty_cache": _nothing,
    "ipc_collect": _nothing,
    "manual_seed": _nothing,  # torch.manual_seed is the one generator's
    "manual_seed_all": _nothing,
    "memory_allocated": _used_bytes,
    "max_memory_allocated": _used_bytes,
    "memory_reserved": _used_bytes,
    "max_memory_reserved": _used_bytes,
    "reset_peak_memory_stats": _nothing,
    "reset_max_memory_allocated": _nothing,
    "mem_get_info": _free_and_all_bytes,
    "Event": Event,
    "Stream": Stream,
    "current_stream": lambda device=None: Stream(),
    "default_stream": lambda device=None: Stream(),
    "stream": lambda stream: nullcontext(),
    "FloatTensor": torch.FloatTensor,
    "DoubleTensor": torch.DoubleTensor,
    "LongTensor": torch.LongTensor,
    "IntTensor": torch.IntTensor,
    "ByteTensor": torch.ByteTensor,
    "BoolTensor": torch.BoolTensor,
}


def replace_cuda(mode: CpuForCuda) -> None:
    """Put the above in `torch.cuda`'s place; loaders work in this process, files load onto the CPU.

    Args:
        mode: to be on in backward passes too. It is off while it answers the call that starts one.
    """
    import_module("torch._dynamo")  # lists torch's functions when first imported, and refuses a list with strangers
    for name, value in CUDA.items():
        setattr(torch.cuda, name, value)
    _load_in_this_process()
    run_backward = torch.autograd._engine_run_backward

    def with_mode(*args, **kwargs):
        with mode:
            return run_backward(*args, **kwargs)

    torch.autograd._engine_run_backward = with_mode
    load = torch.load
    torch.load = lambda f, map_location=None, *args, **kwargs: load(f, CPU, *args, **kwargs)


def _load_in_this_process() -> None:
    """Load in this process: a loader's 16 would fight over two cores, and a thread that pins pages needs CUDA."""
    original = DataLoader.__init__

    def __init__(self, dataset, batch_size=1, shuffle=None, sampler=None, batch_sampler=None, num_workers=0, **options):
        for word in ("pin_memory", "persistent_workers", "prefetch_factor", "multiprocessing_context", "timeout"):
            options.pop(word, None)
        original(self, dataset, batch_size, shuffle, sampler, batch_sampler, 0, **options)

    DataLoader.__init__ = __init__  # type: ignore[assignment, method-assign]
