"""A sensor: mosaic, noise, white balance and demosaicking on tensors, on their own device, with gradients."""

import operator
import os
from typing import Any

import torch
from torch import nn
from torch.nn import functional

from .._isoplanat import sensor_facts

# Least illumination that a flat field makes up for.
_DARKEST = 0.01

# H. S. Malvar, L.-W. He, R. Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images", ICASSP 2004, in sixteenths.
_ITSELF = [[0] * 5, [0] * 5, [0, 0, 16, 0, 0], [0] * 5, [0] * 5]
_GREEN = [[0, 0, -2, 0, 0], [0, 0, 4, 0, 0], [-2, 4, 8, 4, -2], [0, 0, 4, 0, 0], [0, 0, -2, 0, 0]]
_ALONG_ROW = [[0, 0, 1, 0, 0], [0, -2, 0, -2, 0], [-2, 8, 10, 8, -2], [0, -2, 0, -2, 0], [0, 0, 1, 0, 0]]
_ALONG_COLUMN = [list(column) for column in zip(*_ALONG_ROW, strict=True)]
_OPPOSITE = [[0, 0, -3, 0, 0], [0, 4, 0, 4, 0], [-3, 0, 12, 0, -3], [0, 4, 0, 4, 0], [0, 0, -3, 0, 0]]
_KERNELS = [_ITSELF, _GREEN, _ALONG_ROW, _ALONG_COLUMN, _OPPOSITE]


def _kernel(layout: str, row: int, column: int, channel: int) -> int:
    """Which kernel gives a channel at a place of a layout."""
    at = "RGB".index
    here = at(layout[2 * (row % 2) + column % 2])
    if here == channel:
        return 0
    if channel == 1:
        return 1
    if here != 1:
        return 4
    beside = at(layout[2 * (row % 2) + (column + 1) % 2])
    return 2 if beside == channel else 3


class Sensor(nn.Module):
    """What a sensor makes of captures: ``picture = sensor(captures)``, [B, 3, H, W], demosaicked and white; no saturation, no rounding. Noise is drawn in evaluation, too.

    A pixel that collects the share y of its full well N has the variance level² (y / N + (read noise / N)²). The draw is held in the gradient.

    Parameters
    ----------
    sensor : "generic" or a sensor's file
    level : float
        Times the sensor's own deviation. 0: mosaic alone.
    exposure : float
        Share of the full well that white on the axis collects in green.
    demosaic : bool
        False: the mosaic itself, white, [B, 1, H, W].

    Attributes
    ----------
    facts : dict
        cfa, full_well_electrons, read_noise_electrons, neutral_response, bits, black_level, white_level.
    """

    _masks: torch.Tensor
    _which: torch.Tensor
    _weights: torch.Tensor

    def __init__(
        self, sensor: str | os.PathLike[str] = "generic", *, level: float = 1.0, exposure: float = 1.0, demosaic: bool = True
    ) -> None:
        super().__init__()
        if not level >= 0 or not exposure > 0:
            raise ValueError(f"level, exposure: {level}, {exposure}; 0 or more, and more than 0")
        self.facts: dict[str, Any] = sensor_facts(sensor)
        self.level, self.exposure, self.demosaic = level, exposure, demosaic
        layout: str = self.facts["cfa"]
        # One of each channel at each place of a 2 × 2 of pixels.
        masks = torch.zeros(3, 2, 2)
        which = torch.zeros(3, len(_KERNELS), 2, 2)
        for row in range(2):
            for column in range(2):
                masks["RGB".index(layout[2 * row + column]), row, column] = 1
                for channel in range(3):
                    which[channel, _kernel(layout, row, column, channel), row, column] = 1
        self.register_buffer("_masks", masks, persistent=False)
        self.register_buffer("_which", which, persistent=False)
        self.register_buffer("_weights", torch.tensor(_KERNELS, dtype=torch.float32)[:, None] / 16, persistent=False)

    def _over(self, tile: torch.Tensor, places: list[tuple[int, int]], like: torch.Tensor) -> torch.Tensor:
        """A 2 × 2 repeated over patches whose first pixels stand at ``places``: [places, …, row, column]."""
        rows, columns = like.shape[-2:]
        shifted = torch.stack([tile.to(like).roll((-(row % 2), -(column % 2)), (-2, -1)) for row, column in places])
        repeated = shifted.repeat(*[1] * (tile.ndim - 1), (rows + 1) // 2, (columns + 1) // 2)
        return repeated[..., :rows, :columns]

    @staticmethod
    def _places(place: Any, count: int) -> list[tuple[int, int]]:
        """One for all captures, or one for each."""
        try:
            listed = place.tolist() if hasattr(place, "tolist") else list(place)
            pairs = [listed] if len(listed) == 2 and not hasattr(listed[0], "__len__") else listed
            places = [(operator.index(row), operator.index(column)) for row, column in pairs]
        except (TypeError, ValueError):
            places = []
        if len(places) not in (1, count) or not places:
            raise ValueError(f"place: {place}; a row and column for all captures, or for each of the {count}")
        return places

    def forward(
        self,
        captures: torch.Tensor,
        place: Any = (0, 0),
        *,
        illumination: torch.Tensor | None = None,
        generator: torch.Generator | None = None,
        draw: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """The picture.

        Parameters
        ----------
        captures : tensor [B, 3, H, W]
            Light relative to white, as `LensLayer` gives it; 3 pixels a side or more.
        place : (int, int), or tensor or sequence [B, 2] of int
            Row and column of the first pixel, which say how the mosaic lies.
        illumination : tensor [B, 3, H, W], optional
            How the lens dims the captures, as `LensLayer` gives it: the picture is divided by it behind the noise, down to a hundredth, as cameras do with their
            flat field.
        generator : torch.Generator, optional
            Where the noise is drawn from.
        draw : tensor [B, H, W], optional
            The noise itself, in its own deviations, in place of one that is drawn.
        """
        if not isinstance(captures, torch.Tensor) or not captures.is_floating_point():
            raise TypeError(f"captures: {getattr(captures, 'dtype', type(captures).__name__)}; a tensor of linear light in floating point")
        if torch.is_autocast_enabled(captures.device.type):
            with torch.autocast(captures.device.type, enabled=False):
                return self.forward(captures, place, illumination=illumination, generator=generator, draw=draw)
        if captures.dtype in (torch.float16, torch.bfloat16):
            dims = None if illumination is None else illumination.float()
            return self.forward(captures.float(), place, illumination=dims, generator=generator, draw=draw).to(captures.dtype)
        if captures.ndim != 4 or captures.shape[1] != 3 or min(captures.shape[-2:]) < 3:
            raise ValueError(f"captures: shape {tuple(captures.shape)}; [B, 3, H, W] of 3 pixels a side or more")
        if illumination is not None and illumination.shape != captures.shape:
            raise ValueError(f"illumination: shape {tuple(illumination.shape)}; that of the captures, {tuple(captures.shape)}")
        if draw is not None and draw.shape != captures[:, 0].shape:
            raise ValueError(f"draw: shape {tuple(draw.shape)}; one number a pixel, {tuple(captures[:, 0].shape)}")
        places = self._places(place, len(captures))
        masks = self._over(self._masks, places, captures)
        neutral = torch.as_tensor(self.facts["neutral_response"]).to(captures)[:, None, None] * masks
        response = neutral.sum(1) * self.exposure
        signal = (captures * masks).sum(1) * response
        if self.level > 0:
            well = self.facts["full_well_electrons"]
            variance = signal.clamp(min=0) / well + (self.facts["read_noise_electrons"] / well) ** 2
            if draw is None:
                draw = torch.randn(signal.shape, generator=generator, dtype=captures.dtype, device=captures.device)
            signal = signal + self.level * torch.sqrt(variance.clamp(min=torch.finfo(variance.dtype).tiny)) * draw.to(signal)
        white = (signal / response)[:, None]
        if illumination is not None:
            dims = (illumination.to(captures) * masks).sum(1, keepdim=True)
            white = torch.where(dims > 0, white / dims.clamp(min=_DARKEST), 0)
        if not self.demosaic:
            return white
        found = functional.conv2d(functional.pad(white, (2, 2, 2, 2), mode="reflect"), self._weights.to(captures))
        which = self._over(self._which, places, captures).expand(len(found), -1, -1, -1, -1)
        return torch.einsum("bkhw,bckhw->bchw", found, which)
