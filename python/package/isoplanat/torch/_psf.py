"""Point spread functions as tensors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from .._isoplanat import Lens, numbers_of
from ._numbers import Numbers


class _Kernels(torch.autograd.Function):
    """Numbers to kernels."""

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, lens: Lens, names: list[str], options: dict[str, Any]) -> torch.Tensor:
        moved = lens.replace(dict(zip(names, values.detach().cpu().tolist(), strict=True)))
        ctx.psf, ctx.names, ctx.device = moved.psf(**options), names, values.device
        return torch.from_numpy(np.array(ctx.psf.kernels)).to(values.device)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator]
    def backward(ctx: Any, bar: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        gradient = ctx.psf.vjp(bar.detach().cpu().contiguous().numpy())
        return torch.tensor([gradient[name] for name in ctx.names], dtype=torch.float64, device=ctx.device), None, None, None


class PsfLayer(Numbers):
    """Point spread functions of a lens whose numbers are trained: ``kernels = layer()``, [distance, field, channel, row, column].

    Parameters
    ----------
    lens : Lens
    fields_deg, distances_mm, pitch_um, size, and all other options
        As of `Lens.psf`; ``dtype="float64"`` gives kernels in float64.
    trainable : str or sequence of str
        Names or patterns of the lens's numbers, as of `LensLayer`.

    Kernels are over the sensor, upright, and sum to what falls into them; they are placed about each one's own light, as `Lens.psf` says.

    Attributes
    ----------
    numbers : torch.nn.ParameterDict
        As of `LensLayer`.
    """

    def __init__(
        self,
        lens: Lens,
        fields_deg: Any = None,
        distances_mm: Any = None,
        pitch_um: float | None = None,
        size: int | None = None,
        *,
        trainable: str | Sequence[str] = ("surface[*].curvature",),
        **options: Any,
    ) -> None:
        names, values = numbers_of(lens, trainable)
        super().__init__(names, values)
        self._lens = lens
        self._options = {"fields_deg": fields_deg, "distances_mm": distances_mm, "pitch_um": pitch_um, "size": size, **options}

    @property
    def lens(self) -> Lens:
        """The lens as it is now. Raises ValueError where its numbers are no lens."""
        return self._lens.replace(dict(zip(self._all_names, self._values().tolist(), strict=True)))

    @torch.compiler.disable  # type: ignore[untyped-decorator,unused-ignore]
    def forward(self) -> torch.Tensor:
        """The kernels, on the numbers' device."""
        kernels: torch.Tensor = _Kernels.apply(self._values(), self._lens, self._all_names, self._options)  # type: ignore[no-untyped-call]
        return kernels
