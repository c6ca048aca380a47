"""Opens a dataset by LeRobot's own training factory and iterates over it: run in the environment that `make lerobot-env` makes.

usage: python lerobot_opens.py FOLDER; prints what was found as JSON.
"""

import json
import sys

import torch

# The operators of torchvision's build for graphics cards do not load beside a torch without; nothing here calls them, but
# their shapes are registered on import.
operators = torch.library.Library("torchvision", "DEF")
for name in ("nms", "qnms"):
    operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

from lerobot.configs.default import DatasetConfig  # noqa: E402
from lerobot.configs.train import TrainPipelineConfig  # noqa: E402
from lerobot.datasets.factory import make_dataset  # noqa: E402
from lerobot.policies.act.configuration_act import ACTConfig  # noqa: E402
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig  # noqa: E402

PICTURE = "observation.images.gelsight"


def opened(folder, policy, **more):
    """The dataset as LeRobot's training makes it."""
    return make_dataset(TrainPipelineConfig(DatasetConfig("gelforge/lab", root=folder, **more), policy=policy))


def main() -> None:
    folder, found = sys.argv[1], {}
    for name, policy in (("act", ACTConfig(push_to_hub=False)), ("diffusion", DiffusionConfig(push_to_hub=False))):
        dataset = opened(folder, policy)
        loaded = list(torch.utils.data.DataLoader(dataset, batch_size=4))
        found[name] = {
            "frames": sum(len(batch["index"]) for batch in loaded), "episodes": dataset.meta.total_episodes,
            "shape": list(loaded[0][PICTURE].shape[1:]), "wrench": loaded[0]["observation.wrench"].tolist(),
            "sample_id": [one for batch in loaded for one in batch["sample_id"]],
            "mean": loaded[0][PICTURE].double().mean().item(), "task": loaded[0]["task"][0],
        }  # fmt: skip
    own = opened(folder, ACTConfig(push_to_hub=False), use_imagenet_stats=False)
    found["stats"] = {
        key: {name: torch.as_tensor(value).tolist() for name, value in values.items()}
        for key, values in own.meta.stats.items()
    }
    streamed = opened(folder, ACTConfig(push_to_hub=False), streaming=True)
    found["streamed"] = sum(1 for _ in streamed)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
