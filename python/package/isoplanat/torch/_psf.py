"""Point spread functions as tensors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from .._isoplanat import Lens, Psf, numbers_of
from ._numbers import Numbers, replaced


class _Kernels(torch.autograd.Function):
    """Numbers to kernels."""

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, lens: Lens, names: list[str], like: Psf) -> torch.Tensor:
        moved = replaced(lens, names, values)
        ctx.psf, ctx.names, ctx.device = moved.psf(like=like), names, values.device
        return torch.from_numpy(np.array(ctx.psf.kernels)).to(values.device)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator,unused-ignore]
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
    replan_every : int
        After so many passes in training, kernels are placed anew about their light, as `Lens.psf` places them; 0: never of itself. In between their places are held,
        and the gradient is that of held places. In evaluation they are placed anew whenever the numbers have changed.

    Kernels are over the sensor, upright, and sum to what falls into them.

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
        replan_every: int = 25,
        **options: Any,
    ) -> None:
        names, values = numbers_of(lens, trainable)
        super().__init__(names, values, replan_every)
        self._lens = lens
        self._options = {"fields_deg": fields_deg, "distances_mm": distances_mm, "pitch_um": pitch_um, "size": size, **options}
        self._like: Psf
        self.replan()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_like"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)  # type: ignore[no-untyped-call,unused-ignore]
        self._lay_out()

    def _lay_out(self) -> None:
        numbers = dict(zip(self._all_names, self._planned.tolist(), strict=True))
        self._like = self._lens.replace(numbers).psf(**self._options)

    def replan(self) -> None:
        """Places kernels anew, about the light of the lens as it is now. Raises ValueError where its numbers are no lens; they go back then, as in `forward`."""
        try:
            self._like = self.lens.psf(**self._options)
        except ValueError as error:
            raise self._gone_back(error) from None
        self._passes, self._planned = 0, self._values().detach().clone()

    @property
    def lens(self) -> Lens:
        """The lens as it is now. Raises ValueError where its numbers are no lens."""
        return replaced(self._lens, self._all_names, self._values())

    @torch.compiler.disable  # type: ignore[untyped-decorator,unused-ignore]
    def forward(self) -> torch.Tensor:
        """The kernels, on the numbers' device. Raises ValueError where the numbers are no lens; they go back to those of the last pass then."""
        self._follow()
        try:
            kernels: torch.Tensor = _Kernels.apply(self._values(), self._lens, self._all_names, self._like)  # type: ignore[no-untyped-call,unused-ignore]
        except ValueError as error:
            raise self._gone_back(error) from None
        self._valid = self._values().detach().clone()
        return kernels
