"""Small networks of every family, trained on a synthetic dataset, for tests of evaluation and use."""

from gelforge.flow.schema import altered
from gelforge.learning.data import open_data
from gelforge.learning.train import save_trained
from gelforge.stages.train import train
from tests.support.parameters import parameters, with_values
from tests.support.synthetic_presses import SETTINGS, write_dataset

IMAGE, GRID = (48, 64), (6, 8)
SMALL = {"kind": "grid", "width": 8, "blocks": 1}
LEARNING = {"epochs": 40, "learning_rate": 4e-3, "total_weight": 1.0}
MODELS = {
    "unet": {"kind": "unet", "widths": [4, 8]},
    "pair": SMALL,
}
EVALUATE = altered(parameters().evaluate, force_edges=(0.0, 5.0, 20.0), bootstrap=50)


def learnt(folder):
    """SMALL, trained with LEARNING on a dataset's folder until it predicts its forces."""
    return train(open_data(folder), "small", SMALL, with_values(SETTINGS, **LEARNING))


def small_dataset(folder):
    """48 presses of all splits (learning.data.Data), with images of size IMAGE and labels of size GRID."""
    return open_data(write_dataset(folder / "6x8", 48, IMAGE, GRID))


def small_models(data) -> dict:
    """The networks of MODELS, trained for two epochs each."""
    return {name: train(data, name, model, with_values(SETTINGS, epochs=2)) for name, model in MODELS.items()}


def small_files(models: dict, folder) -> dict:
    """Save networks; return their files by name."""
    for name, trained in models.items():
        save_trained(folder / f"{name}.onnx", trained)
    return {name: folder / f"{name}.onnx" for name in models}
