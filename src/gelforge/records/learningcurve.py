"""How a network's error on its validation presses fell while it trained, and where it would end."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

FEWEST = 4  # epochs that a law of three numbers is fitted to
FURTHER = 10.0  # times the time spent so far at which the law is read


@dataclass(frozen=True)
class Learning:
    """A training's course.

    hours: (n,) at the end of each epoch; error: (n,) least validation error of total force up to there, the sum of its
    three components' mean absolute errors, N. ended: whether more epochs of its schedule would change nothing.
    expected: error at `FURTHER` times the hours, N; None where the training ended or there are too few epochs.
    """

    hours: np.ndarray
    error: np.ndarray
    ended: bool
    expected: float | None


def has_ended(curve: list[dict[str, Any]], train: dict[str, Any]) -> bool:
    """Whether a training's schedule has nothing left to change; curve: its epochs' rows, train: its settings.

    A cosine schedule ends with its last epoch. "plateau" ends where the learning rate has been as low as it may go for
    more than plateau_patience epochs and the validation error was no less in any of these than before.
    """
    if train["schedule"] == "cosine":
        return len(curve) >= train["epochs"]
    waited = train["plateau_patience"] + 1
    before, last = curve[:-waited], curve[-waited:]
    if not before or any(row["learning_rate"] > train["least_rate"] * (1 + 1e-9) for row in last):
        return False
    return min(row["val_total"] for row in last) >= min(row["val_total"] for row in before)


def power_law(hours: np.ndarray, error: np.ndarray, at: float) -> float:
    """Error at `at` hours by a + b t^-c fitted to hours (n,) and error (n,), in the logarithm; never above the last.

    The law is "pow3" of Domhan, Springenberg and Hutter 2015, "Speeding up Automatic Hyperparameter Optimization of Deep
    Neural Networks by Extrapolation of Learning Curves", table 1.
    """
    scaled = hours / hours[-1]

    def law(numbers: np.ndarray, t: Any) -> Any:
        floor, above, fall = numbers
        return floor + above * t**-fall

    least = float(error[-1])
    fitted = least_squares(
        lambda numbers: np.log(law(numbers, scaled) / error),
        x0=[0.5 * least, 0.5 * least, 0.5],
        bounds=([0.0, 1e-12 * least, 0.01], [least, np.inf, 5.0]),
        x_scale=[least, least, 1.0],
    )
    return min(float(law(fitted.x, at / hours[-1])), least)


def learning_of(about: dict[str, Any]) -> Learning | None:
    """The course of a network's training from what its file holds of it; None where that holds no times of epochs."""
    seconds = about["cost"].get("epoch_seconds", [])
    curve = about["curve"]
    if not seconds or len(seconds) != len(curve):
        return None
    hours = np.array(seconds) / 3600
    error = np.minimum.accumulate([row["val_total"] for row in curve])
    ended = has_ended(curve, about["train"])
    known = not ended and len(curve) >= FEWEST and error[-1] > 0
    return Learning(hours, error, ended, power_law(hours, error, FURTHER * hours[-1]) if known else None)
