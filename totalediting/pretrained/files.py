"""Arrays from files of weights, without running any code in them.

`read_pickle` is for pickles of nested dictionaries of numpy arrays: an unpickler that resolves only
the names that numpy's arrays need. `read_onnx` takes the stored tensors (initialisers) of an ONNX
file and nothing of its graph; the few wire types of Protocol Buffers that this needs are read here,
as the `onnx` package and MediaPipe ask for different versions of `protobuf`.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from totalediting.pretrained.fetch import NetworkError

_PLAIN = {
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "_reconstruct"),
}
# onnx.proto: numbers of the fields of ModelProto, GraphProto and TensorProto that are read.
_GRAPH, _INITIALISER = 7, 5
_DIMS, _TYPE, _FLOATS, _INT32S, _INT64S, _NAME, _RAW = 1, 2, 4, 5, 7, 8, 9
_DTYPES = {1: np.dtype("<f4"), 3: np.dtype("i1"), 6: np.dtype("<i4"), 7: np.dtype("<i8")}


class _ArrayUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _PLAIN:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}, which is no array")
        return super().find_class(module, name)


def read_pickle(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a pickle of nested dictionaries, by their keys joined with "/".

    Raises:
        NetworkError: the file asks for anything but arrays, holds something else or is damaged.
    """
    try:
        with open(path, "rb") as file:
            found = _ArrayUnpickler(file).load()
        return dict(_leaves(found, ""))
    except Exception as error:  # a damaged pickle can raise nearly anything
        raise NetworkError(f"{path}: not a pickle of arrays: {_one_line(error)}") from None


def _leaves(value: Any, key: str) -> Iterator[tuple[str, np.ndarray]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, f"{key}/{name}" if key else str(name))
    elif isinstance(value, np.ndarray) and value.dtype.kind == "f":
        yield key, value
    else:
        raise TypeError(f"{key or 'its root'} is {type(value).__name__}, no array of numbers")


def read_onnx(path: Path) -> dict[str, np.ndarray]:
    """The initialisers of an ONNX file by name: float32, int8, int32 and int64 ones.

    Raises:
        NetworkError: the file is no ONNX file, or damaged.
    """
    try:
        tensors: dict[str, np.ndarray] = {}
        for number, graph in _fields(memoryview(path.read_bytes())):
            if number == _GRAPH:
                tensors |= dict(_tensor(t) for n, t in _fields(graph) if n == _INITIALISER)
    except (ValueError, IndexError, KeyError, TypeError, OverflowError) as error:
        raise NetworkError(f"{path}: not a readable ONNX file: {_one_line(error)}") from None
    if not tensors:
        raise NetworkError(f"{path}: not a readable ONNX file: it holds no tensors")
    return tensors


def _tensor(message: memoryview) -> tuple[str, np.ndarray]:
    """Name and values of a TensorProto."""
    name, kind, dims, numbers = "", 0, [], []
    values = None
    for number, value in _fields(message):
        if number == _NAME:
            name = bytes(value).decode()
        elif number == _TYPE:
            kind = value
        elif number == _DIMS:
            dims += _integers(value)
        elif number == _RAW:
            values = np.frombuffer(value, _DTYPES[kind])
        elif number == _FLOATS:
            values = np.frombuffer(value, np.dtype("<f4"))
        elif number in (_INT32S, _INT64S):
            numbers += _integers(value)
    if kind not in _DTYPES:
        raise ValueError(f"tensor {name!r} is of type {kind}")
    if values is None:
        values = np.array(numbers, np.int64).astype(_DTYPES[kind])
    return name, values.reshape(dims)


def _integers(value: Any) -> list[int]:
    """A repeated integer field: one number, or many packed; two's complement in 64 bits."""
    if isinstance(value, int):
        return [value]
    found, at = [], 0
    while at < len(value):
        number, at = _varint(value, at)
        found.append(number - (1 << 64) if number >> 63 else number)
    return found


def _fields(message: memoryview) -> Iterator[tuple[int, Any]]:
    """(field number, integer or bytes) of a message of Protocol Buffers, in the file's order."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        wire = tag & 7
        if wire == 0:
            value, at = _varint(message, at)
        elif wire in (1, 2, 5):
            size, at = _varint(message, at) if wire == 2 else ((8 if wire == 1 else 4), at)
            if at + size > len(message):
                raise ValueError("it ends early")
            value, at = message[at : at + size], at + size
        else:
            raise ValueError(f"unknown wire type {wire}")
        yield tag >> 3, value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    number = shift = 0
    while True:
        byte = message[at]
        at += 1
        number |= (byte & 127) << shift
        if byte < 128:
            return number, at
        shift += 7


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
