"""Networks of TensorFlow Lite, run by LiteRT (package `ai-edge-litert`, extra `edit`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from totalediting.errors import InputError
from totalediting.pretrained.fetch import NetworkError


def interpreter_of(content: bytes) -> Any:
    """A network of a `.tflite` file, on one CPU thread.

    Raises:
        InputError: the package `ai-edge-litert` is not installed.
        NetworkError: it is no network.
    """
    try:
        from ai_edge_litert.interpreter import (  # pyright: ignore[reportMissingImports]
            Interpreter,
        )
    except ImportError:
        raise InputError(
            "ai-edge-litert, which runs the networks that find faces, is not installed; "
            "pip install 'totalediting[edit]'"
        ) from None
    try:
        interpreter = Interpreter(model_content=content, num_threads=1)
        interpreter.allocate_tensors()
    except (ValueError, RuntimeError) as error:
        raise NetworkError(f"not a network of TensorFlow Lite: {error}") from None
    return interpreter


def run(interpreter: Any, values: np.ndarray) -> dict[tuple[int, ...], np.ndarray]:
    """Outputs of a network for one input, without its leading axis, by their shapes."""
    (place,) = interpreter.get_input_details()
    interpreter.set_tensor(place["index"], values[None].astype(np.float32))
    interpreter.invoke()
    outputs = [interpreter.get_tensor(out["index"]) for out in interpreter.get_output_details()]
    return {output.shape: output for output in outputs}
