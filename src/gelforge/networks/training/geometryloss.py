"""What a network of two stages is taught by: the gel's shape where the virtual rig gave it, and forces from both."""

import torch
from torch.nn import functional as F

from gelforge.networks.models.geometry import GeometryNet

LEAST_N = 1.0  # N below which an error of force counts as much as at this force
# How wrong the shape that the second stage is taught with may be: slopes by a factor, of both and of each axis, and by smooth
# fields; motion by a zoom and turn of the whole gel, a shift in px, and smooth fields in px. Real tables and holders do so.
GAIN, AXIS_GAIN, FIELDS = 0.12, 0.05, ((6, 8, 0.03), (24, 32, 0.03))
SIMILARITY, SHIFT_PX, MOTION_PX = 0.004, 0.5, 0.15
WITHOUT_MOTION = 0.3  # fraction of shapes whose motion is left out, as on a gel without markers
SHAPE_WEIGHT, TRUE_SHAPE_WEIGHT = 0.15, 0.5
CONTRAST = 8.0  # by how much more a slope of one counts than a level place, which most of a picture is


def relative_loss(output, target, scale) -> torch.Tensor:
    """Errors of force in fractions of each press' own normal force, so that light presses count as firm ones do.

    output, target: (n, 3, rows, cols) in training units; scale: (3,) N. Sum of the mean square error of cells over the force to
    the power 1.5, smooth L1 of the normal force's logarithm, and that of shear over a tenth of the normal force.
    """
    output, target = output * scale.view(1, 3, 1, 1), target * scale.view(1, 3, 1, 1)
    total, true_total = output.sum((2, 3)), target.sum((2, 3))
    normal = -true_total[:, 2]
    per_cell = ((output - target) ** 2).sum((1, 2, 3))
    cells = (per_cell / (normal.clamp(min=0) + LEAST_N) ** 1.5).mean()
    found, true = (torch.log(one.clamp(min=0) + 0.3) for one in (-total[:, 2], normal))
    shear = F.smooth_l1_loss(total[:, :2], true_total[:, :2], beta=0.1, reduction="none").sum(1)
    shear = (shear / (0.1 * normal.clamp(min=0) + 0.3)).mean()
    return 2.0 * cells + F.smooth_l1_loss(found, true, beta=0.1) + 0.3 * shear


def shape_loss(slopes, motion, true_slopes, true_motion) -> torch.Tensor:
    """Errors of predicted slopes (n, 2, h, w) and motion (n, 2, k, l) px against those of the rig."""
    weight = 1.0 + CONTRAST * true_slopes.norm(dim=1, keepdim=True)
    error = F.smooth_l1_loss(slopes, true_slopes, beta=0.1, reduction="none")
    return 60.0 * (weight * error).mean() + F.smooth_l1_loss(motion, true_motion, beta=0.3)


def taught(net: GeometryNet, pairs, target, slopes, motion, scale, generator: torch.Generator) -> torch.Tensor:
    """Loss of a batch whose shapes are known.

    pairs: (n, 6, h, w) inputs; target: (n, 3, rows, cols) in training units; slopes (n, 2, h / 2, w / 2), motion (n, 2, h / 8,
    w / 8) px. The second stage learns from the shape that the first one predicts and, for half of the batch, from the true one,
    disturbed.
    """
    seen_slopes, seen_motion = net.slopes(pairs)
    loss = SHAPE_WEIGHT * shape_loss(seen_slopes, seen_motion, slopes, motion)
    loss = loss + relative_loss(net.forces(seen_slopes, seen_motion), target, scale)
    half = len(slopes) // 2 or 1
    true_slopes, true_motion = disturbed(slopes[:half], motion[:half], generator)
    true_slopes, true_motion, mirrored_target = mirrored(true_slopes, true_motion, target[:half], generator)
    return loss + TRUE_SHAPE_WEIGHT * relative_loss(net.forces(true_slopes, true_motion), mirrored_target, scale)


def disturbed(slopes, motion, generator: torch.Generator):
    """Shapes as a sensor's own table and holder may make them; see GAIN and the lines below it."""
    n, device = len(slopes), slopes.device

    def normal(*shape):
        return torch.randn(n, *shape, generator=generator).to(device)

    def uniform(*shape):
        return 2 * torch.rand(n, *shape, generator=generator).to(device) - 1

    slopes = slopes * (1 + GAIN * uniform(1, 1, 1) + AXIS_GAIN * uniform(2, 1, 1))
    for rows, cols, size in FIELDS:
        field = normal(2, rows, cols) * size * uniform(1, 1, 1) ** 2
        slopes = slopes + F.interpolate(field, slopes.shape[2:], mode="bilinear", align_corners=False)
    high, wide = motion.shape[2:]
    v, u = torch.meshgrid(
        *(8.0 * (torch.arange(count, device=device) - (count - 1) / 2) for count in (high, wide)), indexing="ij"
    )
    zoom, turn = SIMILARITY * normal(1, 1), SIMILARITY * normal(1, 1)
    motion = motion + torch.stack([zoom * u - turn * v, turn * u + zoom * v], 1) + SHIFT_PX * normal(2, 1, 1)
    field = MOTION_PX * normal(2, 5, 6) * uniform(1, 1, 1)
    motion = motion + F.interpolate(field, (high, wide), mode="bilinear", align_corners=False)
    known = torch.rand(n, 1, 1, 1, generator=generator) >= WITHOUT_MOTION
    return slopes, motion * known.to(device)


def mirrored(slopes, motion, target, generator: torch.Generator):
    """Shapes and forces mirrored along each side of the image with even odds: mechanics knows no left and right."""
    for component, side in ((0, 3), (1, 2)):
        chosen = torch.rand(len(slopes), generator=generator) < 0.5
        sign = torch.where(chosen, -1.0, 1.0).view(-1, 1, 1).to(slopes.device)
        flipped = []
        for maps in (slopes, motion, target):
            own = torch.where(chosen.view(-1, 1, 1, 1).to(maps.device), maps.flip(side), maps).clone()
            own[:, component] *= sign
            flipped.append(own)
        slopes, motion, target = flipped
    return slopes, motion, target
