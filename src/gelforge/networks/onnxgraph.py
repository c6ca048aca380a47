"""A model as ONNX, checked against torch before it is published.

The graph takes `image` (n, 3, height, width) float32 RGB in 0..255 and gives `forces`, N per cell; the scales are
inside. That of a network that reads differences also takes `untouched`, as many pictures in the same units. What stands
before the graph is not in it: bring both pictures to the network's scale and the image to the untouched one's light, as
`networks.canonical` does with numpy and OpenCV alone (`view_of`, `View.of`, `Resting`, `View.match`), and lay it onto the
untouched one where the gel sits otherwise (`networks.placement`, which needs torch for its reader of places). A network that
learnt from mirrored pictures reads better both ways: run the graph on both pictures as they are and turned by half, and take
the mean (`networks.bothways`). Then take off what is read so in the untouched picture itself, and multiply by the factor of
the sensor's profile. The readers of dots that stand beside some networks, and what stands above both, are not in it, so
totals differ from those of `predict` by what they have to say.
"""

import importlib.util
import warnings

import numpy as np

OPSET = 17
SAMPLES = 4  # images that a file is compared with torch on
# The most that a force per cell may differ from torch's on the images that are checked, as a share of the range from the
# least to the largest of all their forces per cell. Engines add up in other orders, which alone makes some 3e-6 of it.
TOLERANCE = 1e-5


def export(trained, path) -> None:
    """Write a model as ONNX to exactly `path`, by torch's tracing exporter, which needs no other package."""
    import torch

    graph, inputs = on_tensors(trained), {"image": torch.zeros(1, 3, *trained.about["image"])}
    if trained.needs_untouched:
        inputs["untouched"] = torch.zeros_like(inputs["image"])
    with warnings.catch_warnings():
        # torch prefers an exporter that needs onnx and onnxscript; these networks do not. Scales are constants.
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.simplefilter("ignore", torch.jit.TracerWarning)
        torch.onnx.export(
            graph,
            tuple(inputs.values()),
            str(path),
            dynamo=False,
            opset_version=OPSET,
            input_names=list(inputs),
            output_names=["forces"],
            dynamic_axes={name: {0: "n"} for name in (*inputs, "forces")},
        )


def on_tensors(trained):
    """The network, scales inside, as a module of images and, where it reads differences, of the untouched sensor."""
    import torch

    from gelforge.networks.inputs import network_input

    norm = trained.about["normalisation"]
    scale = torch.tensor(norm["label"]).float().view(1, 3, 1, 1)

    class Graph(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.net = trained.net

        def forward(self, *pictures):
            return self.net(network_input(torch.cat(pictures, 1) / 255, norm)) * scale

    return Graph().eval()


def run_onnx(path, images, untouched=None) -> dict[str, np.ndarray]:
    """Run an ONNX file on images (n, 3, h, w) with every engine at hand: OpenCV's, and ONNX Runtime if installed.

    untouched: (1, 3, h, w) for all of them, where the graph takes it.
    """
    import cv2

    net = cv2.dnn.readNetFromONNX(str(path))
    others = {} if untouched is None else {"untouched": untouched}
    results = []
    for image in images:
        for name, value in ({"image": image[None]} | others).items():
            net.setInput(value, name)
        results.append(net.forward()[0])
    outputs = {"opencv": np.stack(results)}
    if importlib.util.find_spec("onnxruntime"):
        import onnxruntime

        session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        outputs["onnxruntime"] = np.concatenate(
            [session.run(None, {"image": image[None]} | others)[0] for image in images]
        )
    return outputs


def largest_difference(trained, path, images) -> dict[str, float]:
    """Largest difference between an ONNX file and torch on images (n, h, w, 3) uint8, as a share of the range.

    The last image serves as the untouched sensor, where the network reads differences.
    """
    from gelforge.networks.modelfile import SensorNet, predict_images

    wanted = predict_images(SensorNet(trained, images[-1]).eval(), images)
    span = float(np.ptp(wanted)) or 1.0
    tensors = np.ascontiguousarray(images.transpose(0, 3, 1, 2)).astype(np.float32)
    found = run_onnx(path, tensors, tensors[-1:] if trained.needs_untouched else None)
    return {engine: float(np.abs(got - wanted).max() / span) for engine, got in found.items()}


def sample_images(size) -> np.ndarray:
    """Images (SAMPLES, h, w, 3) of noise over a slope: no symmetry that could hide a swapped axis."""
    rng = np.random.default_rng(0)
    slope = np.linspace(30, 200, size[1])[None, None, :, None]
    return np.clip(slope + rng.normal(0, 30, (SAMPLES, *size, 3)), 0, 255).astype(np.uint8)
