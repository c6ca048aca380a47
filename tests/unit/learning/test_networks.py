"""Families of networks: their shapes and what they read."""

import subprocess
import sys

import pytest
import torch

from gelforge.flow.files import read_toml
from gelforge.learning.nets import BasicBlock, UNet, build, map_grid, network_input, parameter_count, strides
from gelforge.stages.train import resolve
from tests.support.parameters import parameters
from tests.support.refused import refused
from tests.support.small_networks import GRID, IMAGE, SMALL


def test_unet_is_the_papers():
    net = UNet((24, 32)).eval()
    seen = {}
    net.head.register_forward_hook(lambda module, inputs, output: seen.update(size=tuple(output.shape[2:])))
    with torch.inference_mode():
        assert net(torch.zeros(1, 3, 240, 320)).shape == (1, 3, 24, 32)
    # Four halvings and 18 unpadded convolutions of 240 x 320 by hand: 7 x 12 at the bottom, 52 x 132 at the top.
    assert seen["size"] == (52, 132)
    pairs = [(3, 16), (16, 32), (32, 64), (64, 128), (128, 256)]
    down = sum(9 * a * b + b + 9 * b * b + b for a, b in pairs)
    up = sum(4 * a * b + b + 9 * a * b + b + 9 * b * b + b for b, a in pairs[1:])
    assert parameter_count(net) == down + up + 16 * 3 + 3


def test_grid_net_writes_any_grid_that_divides_the_image_and_totals():
    for grid in ((12, 16), (48, 64), (30, 40), (1, 1)):
        with torch.inference_mode():
            assert build(SMALL, (240, 320), grid).eval()(torch.zeros(1, 6, 240, 320)).shape == (1, 3, *grid)


def test_totals_alone_come_from_a_map_of_small_cells():
    """A grid of one cell is no other network: the same map, of which the mean is kept."""
    assert map_grid((240, 320), (1, 1)) == (24, 32) and map_grid((48, 64), (1, 1)) == (6, 8)
    total, cells = (build(SMALL, IMAGE, grid).eval() for grid in ((1, 1), map_grid(IMAGE, (1, 1))))
    total.load_state_dict(cells.state_dict())
    pictures = torch.randn(2, 6, *IMAGE, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        torch.testing.assert_close(total(pictures), cells(pictures).mean((2, 3), keepdim=True))


def test_a_thinned_shortcut_is_the_strided_convolution():
    block, x = BasicBlock(6, 10, stride=2).eval(), torch.randn(3, 6, 11, 14)
    convolution, norm = block.shortcut
    strided = norm(torch.nn.functional.conv2d(x, convolution.weight, stride=2))
    rest = torch.relu(block.first_norm(block.first(x)))
    expected = torch.relu(block.second_norm(block.second(rest)) + strided)
    torch.testing.assert_close(block(x), expected, rtol=1e-5, atol=1e-6)


NARROW = """
import torch
from gelforge.learning.nets import BasicBlock

for before in (3, 4, 8):
    block = BasicBlock(before, 2 * before, stride=2).to(memory_format=torch.channels_last)
    for step in range(20):
        x = torch.randn(8, before, 48, 64).to(memory_format=torch.channels_last).requires_grad_()
        block(x).square().sum().backward()
        beside = [torch.randn(7, step + 1) for _ in range(5)]
"""


@pytest.mark.processes
def test_narrow_networks_train_without_corrupting_memory():
    ran = subprocess.run([sys.executable, "-c", NARROW], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-500:]


def test_every_network_of_the_table_builds(root):
    models = read_toml(root / "workflow" / "models.toml")
    settings = parameters().train
    assert models
    for name in models:
        model, own = resolve(models, name, settings)
        assert build(model, (240, 320), (24, 32)) is not None
        assert own.epochs == models[name].get("train", {}).get("epochs", settings.epochs)


def test_a_kind_may_get_epochs_of_its_own():
    settings = parameters(train={"epochs_of": {"unet": 7}}).train
    assert resolve({"small": SMALL}, "small", settings)[1].epochs == settings.epochs
    assert resolve({"paper": {"kind": "unet"}}, "paper", settings)[1].epochs == 7
    assert resolve({"paper": {"kind": "unet", "train": {"epochs": 9}}}, "paper", settings)[1].epochs == 9


def test_a_unet_is_refused_exactly_the_images_that_it_cannot_read():
    for widths in ([2], [2, 2, 2]):
        read = []
        for side in (*range(1, 50), 99):
            try:
                with torch.inference_mode():
                    UNet(GRID, widths)(torch.zeros(1, 3, side, 100))
                read.append(side)
            except RuntimeError:  # torch: nothing is left to convolve
                said = f"leaves nothing of an image of 100 x {side}"
                refused(said, build, {"kind": "unet", "widths": widths}, (side, 100), GRID)
            else:
                assert build({"kind": "unet", "widths": widths}, (side, 100), GRID)
        assert 1 not in read and 99 in read


def test_unknown_kind_and_wrong_size_are_named():
    for model, said in (
        ({"kind": "transformer"}, "transformer"),
        ({"kind": "grid", "depth": 3}, "'depth': its sizes are width, blocks"),
        ({"kind": "unet", "widths": 24}, "widths is '24', it must be a list of 1 to 16 whole numbers from 1 to 4096"),
    ):
        refused(said, build, model, IMAGE, GRID)
    for image, grid in (((240, 320), (7, 9)), ((240, 320), (24, 24)), ((24, 32), (24, 32))):
        refused("a light net: ", strides, image, grid)  # cells of uneven size
    refused("MODEL=nothing", resolve, {"grid": SMALL}, "nothing", parameters().train)
    odd = {"grid": {**SMALL, "train": {"epoch": 3}}}
    said = r"models.toml: \[grid.train\] epoch: unknown key; did you mean epochs"
    refused(said, resolve, odd, "grid", parameters().train)


def test_a_pair_is_the_image_and_a_difference_that_forgets_the_no_contact_image():
    pictures = torch.rand(2, 6, 4, 4, generator=torch.Generator().manual_seed(0))
    brighter = pictures + torch.rand(2, 3, 4, 4, generator=torch.Generator().manual_seed(1)).repeat(1, 2, 1, 1)
    norm = {"image_mean": [0.3, 0.4, 0.5], "image_std": [0.1, 0.2, 0.3]}
    both = network_input(pictures, norm)
    torch.testing.assert_close(both[:, 3:], network_input(brighter, norm)[:, 3:])
    torch.testing.assert_close(both[:, :3], network_input(pictures[:, :3], norm))


def test_a_u_net_of_symmetric_kernels_sees_a_mirrored_press_mirrored():
    """Its unpadded convolutions, up-convolutions and crops treat all four sides alike."""
    torch.manual_seed(3)
    # the last convolution leaves 32 x 48 of 48 x 64 pixels: a grid of as many cells resizes nothing
    net = build({"kind": "unet", "widths": [4, 8]}, (48, 64), (32, 48))
    with torch.no_grad():
        for value in net.parameters():
            if value.dim() == 4:
                value.copy_((value + value.flip(2) + value.flip(3) + value.flip(2, 3)) / 4)
        image = torch.rand(1, 3, 48, 64)
        found = net(image)
        for axis in (2, 3):
            torch.testing.assert_close(net(image.flip(axis)), found.flip(axis), atol=1e-5, rtol=1e-4)
        assert not torch.allclose(found, found.flip(3), atol=1e-3)


def test_every_cell_of_a_light_net_knows_of_the_whole_image():
    """Its global means carry a change in one corner to the opposite one, which no convolution reaches."""
    torch.manual_seed(5)
    net = build({"kind": "grid", "width": 8, "blocks": 1}, (240, 320), (24, 32)).eval()
    image = torch.rand(1, 6, 240, 320)
    changed = image.clone()
    changed[..., :20, :20] += 1.0
    with torch.inference_mode():
        assert (net(changed) - net(image)).abs()[..., -1, -1].max() > 1e-6
