"""An ONNX graph on onnxruntime."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gelforge.errors import BadInput

PROVIDERS = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider", "coreml": "CoreMLExecutionProvider"}
DEVICES = tuple(PROVIDERS)
QUIET = 3  # onnxruntime's severity from which on it prints: errors


class Graph:
    """A graph that is ready to run.

    content: of an ONNX file. where: names it in errors. device: one of DEVICES; BadInput where this computer's onnxruntime has
    none. threads: of one picture.
    """

    def __init__(self, content: bytes, where: str, device: str = "cpu", threads: int = 1) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.log_severity_level = threads, QUIET
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=[provider_of(device)])
        except BadInput:
            raise
        except Exception as error:  # onnxruntime raises a dozen kinds for a graph that is none
            raise BadInput(
                f"{where}: its graph cannot be loaded ({type(error).__name__}); the file is corrupt, or newer than"
                f" this onnxruntime ({onnxruntime.__version__}): update onnxruntime, or copy or train the file again"
            ) from None
        self.inputs = tuple(one.name for one in self._session.get_inputs())
        self.outputs = tuple(one.name for one in self._session.get_outputs())

    def __call__(self, given: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Arrays by the names of the graph's outputs, from arrays by those of its inputs; others are not looked at."""
        found = self._session.run(None, {name: given[name] for name in self.inputs})
        return dict(zip(self.outputs, found, strict=True))


def provider_of(device: str) -> Any:
    """onnxruntime's name of a device; BadInput where it is none, or not there."""
    import onnxruntime

    there = [name for name, provider in PROVIDERS.items() if provider in onnxruntime.get_available_providers()]
    if device not in there:
        raise BadInput(
            f"--device {device}: this onnxruntime runs on {', '.join(there)}; name one of these, or install a build of"
            " onnxruntime for your device (onnxruntime-gpu)"
        )
    return PROVIDERS[device]
