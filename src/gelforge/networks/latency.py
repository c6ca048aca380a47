"""How long one image takes, from pixels in memory to newtons in memory."""

import time

import numpy as np
import torch

from gelforge.networks.modelfile import SensorNet, predict_images

WARM_UP = 5


def time_models(readers: dict[str, SensorNet], image, threads: int, seconds: float, device: str = "cpu") -> dict:
    """Latency of a batch of one for several models, in ms: median, 10th and 90th percentile, runs.

    Conversion and transfers count. The models take turns until each has had `seconds`, so that a
    machine that slows down slows all of them; the first `WARM_UP` runs of each are not counted.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    runs: dict[str, list[float]] = {name: [] for name in readers}
    spent = dict.fromkeys(readers, 0.0)
    try:
        for reader in readers.values():
            reader.to(device).eval()
            for _ in range(WARM_UP):
                predict_images(reader, image[None], device)
        while any(spent[name] < seconds for name in readers):
            for name, reader in readers.items():
                if spent[name] < seconds:
                    started = time.perf_counter()
                    predict_images(reader, image[None], device)
                    runs[name].append(time.perf_counter() - started)
                    spent[name] += runs[name][-1]
    finally:
        torch.set_num_threads(before)
    return {name: summarise(1e3 * np.array(values)) for name, values in runs.items()}


def summarise(values) -> dict:
    """Median and spread of run times in ms."""
    low, middle, high = np.quantile(values, [0.1, 0.5, 0.9])
    return {"median_ms": float(middle), "p10_ms": float(low), "p90_ms": float(high), "runs": len(values)}
