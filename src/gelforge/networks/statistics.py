"""How unlike its training images an image is, from a few statistics of the picture."""

import numpy as np

from gelforge.networks.canonical import Light, match_light

# Smallest standard deviation that a statistic is given, so that a uniform training set does not flag
# what no eye could tell apart: grey levels for the colours, a dot or two for the count.
FLOORS = np.array([4.0] * 12 + [2.0] * 3 + [0.15, 2.0, 4.0])
DOT_AREA = (25, 500)  # pixels at 320 x 240; FEATS' dots have about 106
DOT_DEPTH = 18  # grey levels below their surroundings
SHRINKAGE = 0.2
LEAST_THRESHOLD = 3.0
MARGIN = 1.5


def grey_of(image) -> np.ndarray:
    """Mean of the colours of an image (h, w, 3) uint8, (h, w) uint8."""
    import cv2

    return cv2.transform(image, np.full((1, 3), 1 / 3))


def find_dots(image) -> tuple[int, float]:
    """Count the dark dots of an image (h, w, 3) uint8 and return their mean depth in grey levels."""
    import cv2

    # dots of a dozen pixels are as well seen at half the size, at a sixth of the time
    grey = cv2.resize(grey_of(image), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    side = max(3, round(25 * grey.shape[1] / 320) | 1)
    depth = cv2.morphologyEx(grey, cv2.MORPH_BLACKHAT, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    _, mask = cv2.threshold(depth, DOT_DEPTH, 255, cv2.THRESH_BINARY)
    _, _, boxes, _ = cv2.connectedComponentsWithStats(mask)
    scale = grey.shape[0] * grey.shape[1] / (240 * 320)
    area = boxes[1:, cv2.CC_STAT_AREA]
    good = (area >= DOT_AREA[0] * scale) & (area <= DOT_AREA[1] * scale)
    return int(good.sum()), float(cv2.mean(depth, mask)[0])


def describe(image) -> np.ndarray:
    """Statistics (18,) of an image (h, w, 3) uint8: quadrant colours, spread, sharpness, dots and their depth."""
    import cv2

    small = cv2.resize(image, (2, 2), interpolation=cv2.INTER_AREA).astype(float).ravel()
    spread = cv2.meanStdDev(image)[1].ravel()
    rough = cv2.meanStdDev(cv2.Laplacian(grey_of(image), cv2.CV_16S))[1].item()
    return np.array([*small, *spread, np.log(1 + rough**2), *find_dots(image)])


def fit(train: np.ndarray, held_out: np.ndarray) -> dict:
    """Fit the reference of `score` to statistics (n, 18) of training images and set the threshold on others.

    The threshold is `MARGIN` times the worst score of held-out images of the same kind, at least
    `LEAST_THRESHOLD`.
    """
    mean = train.mean(0)
    spread = np.maximum(train.std(0), FLOORS)
    scaled = (train - mean) / spread
    covariance = (1 - SHRINKAGE) * (scaled.T @ scaled) / len(train) + SHRINKAGE * np.eye(train.shape[1])
    model = {"mean": mean.tolist(), "spread": spread.tolist(), "inverse": np.linalg.inv(covariance).tolist()}
    worst = max((score(model, row) for row in held_out), default=0.0)
    return model | {"threshold": max(LEAST_THRESHOLD, MARGIN * worst)}


def score(model: dict, statistics: np.ndarray) -> float:
    """Mahalanobis distance of an image's statistics per dimension; about 1 for an image like the training ones."""
    scaled = (np.asarray(statistics) - model["mean"]) / model["spread"]
    return float(np.sqrt(scaled @ np.asarray(model["inverse"]) @ scaled / len(scaled)))


def fit_to_images(see, train_rows, held_out_rows, most: int = 500) -> dict:
    """Fit `score`'s reference to at most `most` training and held-out rows, evenly picked; see(row): (h, w, 3) uint8."""

    def described(rows):
        picked = rows[np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(int)]
        return np.stack([describe(see(int(row))) for row in picked])

    return fit(described(train_rows), described(held_out_rows))


def distance(image, untouched) -> float:
    """Median over the picture of how far an image is from the untouched sensor, grey levels; images (h, w, 3) uint8.

    A press changes less than half of the picture by much: another sensor's light changes most.
    """
    import cv2

    apart = cv2.resize(cv2.absdiff(image, untouched), (80, 60), interpolation=cv2.INTER_AREA)
    return float(np.median(apart.astype(np.float32).mean(axis=2)))


def pair_limits(pairs) -> dict[str, float]:
    """What good pairs (h, w, 6) of an image and the untouched sensor stay within: beyond, a pair does not belong together.

    largest_distance: `distance`; largest_residual, least_share: of the light that tells one from the other.
    """
    apart, lights = [], []
    for pair in pairs:
        image, untouched = pair[..., :3], np.ascontiguousarray(pair[..., 3:])
        light = match_light(image, untouched)
        apart.append(distance(light.undo(image), untouched))
        lights.append(light)
    return {
        "largest_distance": MARGIN * max(apart),
        "largest_residual": MARGIN * max(light.residual for light in lights),
        "least_share": min(light.share for light in lights) / MARGIN,
    }


def pair_fault(limits: dict, image, untouched, light: Light) -> str:
    """What tells that an image, brought to the light of the untouched picture, is not of its sensor; empty if nothing."""
    if distance(image, untouched) > limits["largest_distance"]:
        return "another sensor than the untouched one"
    unlike = light.residual > limits.get("largest_residual", np.inf) or light.share < limits.get("least_share", 0.0)
    return "too little of it looks like the untouched picture" if light.known and unlike else ""


def judge(model: dict, image, untouched=None, light: Light | None = None) -> dict:
    """Score one image and say whether it is unlike the training images, and in what: `score`, `flag`, `reason`.

    `untouched` is the picture of its sensor and `light` what was taken back, where the network reads differences.
    """
    statistics = describe(image)
    value = score(model, statistics)
    if value <= model["threshold"]:
        fault = pair_fault(model, image, untouched, light) if untouched is not None and light is not None else ""
        return {"score": value, "flag": bool(fault), "reason": fault}
    off = np.abs(statistics - model["mean"]) / model["spread"]
    groups = {"colour": off[:12].max(), "contrast": off[12:15].max(), "sharpness": off[15], "dots": off[16:].max()}
    return {"score": value, "flag": True, "reason": max(groups, key=lambda name: groups[name])}
