"""Open Image Denoise, called in the library that bpy brings along and Cycles itself calls.

Cycles denoises every render by itself: the guides (albedo and normal) of a view anew for each
light, and coverage not at all. Here each is denoised once.
https://www.openimagedenoise.org/documentation.html
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

_DEVICES = {"cpu": 1, "cuda": 3, "optix": 3, "hip": 4, "metal": 5}
_FLOAT3, _HIGH = 3, 6
_NAMES = ("libOpenImageDenoise.so*", "libOpenImageDenoise*.dylib", "OpenImageDenoise.dll")


class Denoiser:
    """One device and its filters, each kept for the next picture of the same size.

    Images are (H, W, 3) float32, linear. Results do not depend on the number of threads.
    """

    def __init__(self, device: str, threads: int) -> None:
        """`device` and `threads` as of `render.render_subject`; the CPU where a GPU cannot do it.

        Raises RuntimeError if bpy comes without the library, or the device fails.
        """
        self._library = _library()
        self._device = self._open(_DEVICES[device], threads) or self._open(1, threads)
        if not self._device:
            raise RuntimeError("Open Image Denoise: no device can be opened")
        self._buffers: dict[tuple[str, int, int], int] = {}
        self._filters: dict[tuple[object, ...], int] = {}

    def guide(self, name: str, image: np.ndarray) -> np.ndarray:
        """A guide without its noise; `name` is "albedo" or "normal"."""
        return self._run({name: image})

    def light(self, image: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """A picture in linear light without its noise, by guides that have none."""
        return self._run({"color": image, "albedo": albedo, "normal": normal}, "hdr", "cleanAux")

    def coverage(self, coverage: np.ndarray) -> np.ndarray:
        """(H, W) in [0, 1] without its noise, which strands leave grainy.

        The denoiser errs towards nothing in the dark. So it is given what shines through and not
        what covers: coverage then lacks no speck inside hair, and its edge is not hard and too
        wide.
        """
        gaps = np.repeat(1 - coverage[..., None], 3, axis=-1)
        return 1 - np.clip(self._run({"color": gaps}, "hdr")[..., 0], 0, 1)

    def _open(self, kind: int, threads: int) -> int | None:
        device = self._library.oidnNewDevice(kind)
        if not device:
            return None
        if kind == _DEVICES["cpu"]:
            self._library.oidnSetDeviceInt(device, b"numThreads", threads)
            self._library.oidnSetDeviceBool(device, b"setAffinity", False)
        self._library.oidnCommitDevice(device)
        if self._error(device):
            self._library.oidnReleaseDevice(device)
            return None
        return device

    def _error(self, device: int) -> str:
        message = ctypes.c_char_p()
        failed = self._library.oidnGetDeviceError(device, ctypes.byref(message))
        return (message.value or b"it failed").decode() if failed else ""

    def _run(self, images: dict[str, np.ndarray], *flags: str) -> np.ndarray:
        height, width = next(iter(images.values())).shape[:2]
        denoise = self._filter(tuple(images), flags, height, width)
        size = height * width * 12
        for name, image in images.items():
            finite = np.ascontiguousarray(np.nan_to_num(image), np.float32)
            buffer = self._buffer(name, height, width)
            self._library.oidnWriteBuffer(buffer, 0, size, finite.ctypes.data)
        self._library.oidnExecuteFilter(denoise)
        result = np.empty((height, width, 3), np.float32)
        buffer = self._buffer("output", height, width)
        self._library.oidnReadBuffer(buffer, 0, size, result.ctypes.data)
        if problem := self._error(self._device):
            raise RuntimeError(f"Open Image Denoise: {problem}")
        return result

    def _buffer(self, name: str, height: int, width: int) -> int:
        key = name, height, width
        if key not in self._buffers:
            size = height * width * 12
            self._buffers[key] = self._library.oidnNewBuffer(self._device, size)
        return self._buffers[key]

    def _filter(
        self, names: tuple[str, ...], flags: tuple[str, ...], height: int, width: int
    ) -> int:
        key = names, flags, height, width
        if key not in self._filters:
            call = self._library
            denoise = call.oidnNewFilter(self._device, b"RT")
            for name in (*names, "output"):
                buffer = self._buffer(name, height, width)
                layout = _FLOAT3, width, height, 0, 0, 0
                call.oidnSetFilterImage(denoise, name.encode(), buffer, *layout)
            for flag in flags:
                call.oidnSetFilterBool(denoise, flag.encode(), True)
            call.oidnSetFilterInt(denoise, b"quality", _HIGH)
            call.oidnCommitFilter(denoise)
            self._filters[key] = denoise
        return self._filters[key]


@lru_cache(maxsize=1)
def denoiser(device: str, threads: int) -> Denoiser:
    """The denoiser of this process."""
    return Denoiser(device, threads)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    spec = find_spec("bpy")
    folders = (spec and spec.submodule_search_locations) or ()
    found = sorted(p for f in folders for name in _NAMES for p in Path(f).rglob(name))
    if not found:
        raise RuntimeError("Open Image Denoise: this bpy comes without it; install bpy from PyPI")
    library = ctypes.CDLL(str(found[0]))
    pointer, text, size = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t
    integer, boolean = ctypes.c_int, ctypes.c_bool
    for name, result, arguments in (
        ("NewDevice", pointer, [integer]),
        ("SetDeviceInt", None, [pointer, text, integer]),
        ("SetDeviceBool", None, [pointer, text, boolean]),
        ("CommitDevice", None, [pointer]),
        ("ReleaseDevice", None, [pointer]),
        ("GetDeviceError", integer, [pointer, ctypes.POINTER(text)]),
        ("NewBuffer", pointer, [pointer, size]),
        ("WriteBuffer", None, [pointer, size, size, pointer]),
        ("ReadBuffer", None, [pointer, size, size, pointer]),
        ("NewFilter", pointer, [pointer, text]),
        ("SetFilterImage", None, [pointer, text, pointer, integer, *[size] * 5]),
        ("SetFilterBool", None, [pointer, text, boolean]),
        ("SetFilterInt", None, [pointer, text, integer]),
        ("CommitFilter", None, [pointer]),
        ("ExecuteFilter", None, [pointer]),
    ):
        function = getattr(library, f"oidn{name}")
        function.restype, function.argtypes = result, arguments
    return library
