"""Residual blocks, and a ResNet to total force."""

from torch import nn
from torch.nn import functional as F

from gelforge.networks.models.unet import COMPONENTS


class BasicBlock(nn.Module):
    """Residual block of two 3 x 3 convolutions with batch normalisation (He et al. 2016, figure 5)."""

    def __init__(self, before: int, after: int, stride: int = 1, dilation: int = 1):
        super().__init__()
        self.first = nn.Conv2d(before, after, 3, stride, dilation, dilation, bias=False)
        self.first_norm = nn.BatchNorm2d(after)
        self.second = nn.Conv2d(after, after, 3, 1, 1, bias=False)
        self.second_norm = nn.BatchNorm2d(after)
        same = stride == 1 and before == after
        self.shortcut = (
            nn.Identity() if same else nn.Sequential(nn.Conv2d(before, after, 1, bias=False), nn.BatchNorm2d(after))
        )
        # A convolution of 1 x 1 that strides corrupts memory when it is trained on fewer than 9 channels, in torch 2.13 on
        # processors with AVX-512 (oneDNN's brgconv_strided); on every second value it is the same convolution.
        self.every = stride

    def forward(self, x):
        # in place: what a normalisation or a convolution gave is needed by nothing else, and memory anew costs time
        y = F.relu(self.first_norm(self.first(x)), inplace=True)
        thinned = x if self.every == 1 else x[:, :, :: self.every, :: self.every]
        return F.relu(self.second_norm(self.second(y)).add_(self.shortcut(thinned)), inplace=True)


class ResNetTotal(nn.Module):
    """ResNet to total force, (n, 3, 1, 1); blocks (3, 4, 6, 3) make ResNet-34 (He et al. 2016, table 1)."""

    def __init__(self, blocks=(3, 4, 6, 3), widths=(64, 128, 256, 512), channels: int = 3):
        super().__init__()
        self.stem = nn.Conv2d(channels, widths[0], 7, 2, 3, bias=False)
        self.stem_norm = nn.BatchNorm2d(widths[0])
        layers, before = [], widths[0]
        for level, (count, width) in enumerate(zip(blocks, widths)):
            for i in range(count):
                layers.append(BasicBlock(before, width, 2 if level > 0 and i == 0 else 1))
                before = width
        self.blocks = nn.Sequential(*layers)
        self.head = nn.Linear(before, COMPONENTS)

    def forward(self, x):
        x = F.max_pool2d(F.relu(self.stem_norm(self.stem(x))), 3, 2, 1)
        return self.head(self.blocks(x).mean((2, 3)))[:, :, None, None]
