"""Rays through a lens as tensors."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from .._isoplanat import Lens, numbers_of
from ._numbers import Numbers, replaced


class Landings(NamedTuple):
    """Where rays arrive, float64.

    Attributes
    ----------
    positions, directions : tensor [..., 3]
        Points on the image plane in its own frame (mm) and unit directions there; nan where a ray does not arrive.
    paths : tensor [...]
        Optical paths from the origins, mm.
    status : tensor [...] of uint8
        0 where a ray arrives, else the place of its failure in `isoplanat.STATUS`.
    """

    positions: torch.Tensor
    directions: torch.Tensor
    paths: torch.Tensor
    status: torch.Tensor


class _Traced(torch.autograd.Function):
    """Numbers, origins and directions to landings; backward traces once more."""

    @staticmethod
    def forward(
        ctx: Any,
        values: torch.Tensor,
        origins: torch.Tensor,
        directions: torch.Tensor,
        lens: Lens,
        names: list[str],
        options: dict[str, Any],
    ) -> tuple[torch.Tensor, ...]:
        moved = replaced(lens, names, values)
        given = [tensor.detach().cpu().contiguous().numpy() for tensor in (origins, directions)]
        rays = moved.trace(*given, **options)
        ctx.save_for_backward(origins, directions)
        ctx.lens, ctx.names, ctx.options, ctx.device = moved, names, options, values.device
        found = [torch.from_numpy(np.array(array)).to(origins.device) for array in (rays.positions, rays.directions, rays.paths, rays.status)]
        ctx.mark_non_differentiable(found[3])
        return tuple(found)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator,unused-ignore]
    def backward(ctx: Any, *landings_bar: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        origins, directions = ctx.saved_tensors
        given = [tensor.detach().cpu().contiguous().numpy() for tensor in (origins, directions)]
        names = ("positions_bar", "directions_bar", "paths_bar")
        bars = {name: bar.detach().cpu().contiguous().numpy() for name, bar in zip(names, landings_bar)}
        gradient, *rays_bar = ctx.lens.trace_vjp(*given, **bars, **ctx.options)
        of_numbers = torch.tensor([gradient[name] for name in ctx.names], dtype=torch.float64, device=ctx.device)
        of_rays = (torch.from_numpy(np.array(bar)).to(tensor) for bar, tensor in zip(rays_bar, (origins, directions)))
        return of_numbers, *of_rays, None, None, None


class RayLayer(Numbers):
    """Exact rays through a lens whose numbers are trained: ``landings = layer(origins, directions)``, with gradients by the numbers and by the rays.

    Parameters
    ----------
    lens : Lens
    trainable : str or sequence of str
        Names or patterns of the lens's numbers, as of `LensLayer`.
    clip : bool
        Stop rays at clear apertures, whose sizes have no gradient.

    Memory does not grow with the surfaces: backward traces once more.

    Attributes
    ----------
    numbers : torch.nn.ParameterDict
        As of `LensLayer`.
    """

    def __init__(self, lens: Lens, *, trainable: str | Sequence[str] = ("surface[*].curvature",), clip: bool = False) -> None:
        names, values = numbers_of(lens, trainable)
        super().__init__(names, values, 0)
        self._lens, self._clip = lens, clip

    def replan(self) -> None:
        """Nothing is laid out for rays."""

    @property
    def lens(self) -> Lens:
        """The lens as it is now. Raises ValueError where its numbers are no lens."""
        return replaced(self._lens, self._all_names, self._values())

    @torch.compiler.disable  # type: ignore[untyped-decorator,unused-ignore]
    def forward(self, origins: torch.Tensor, directions: torch.Tensor, *, wavelength_nm: float | None = None) -> Landings:
        """Where rays arrive, on the origins' device.

        Parameters
        ----------
        origins, directions : tensor [..., 3]
            Points in mm and directions (of any length) in the frame of the first vertex: z along the light, y up. One direction, [3], serves all origins.
        wavelength_nm : float, optional
            The lens's primary wavelength where left out.

        Raises ValueError where the numbers are no lens; they go back to those of the last pass then.
        Rays that do not arrive are nan and have no gradient: ``landings.positions[landings.status == 0]`` are the others.
        """
        for name, tensor in (("origins", origins), ("directions", directions)):
            if not isinstance(tensor, torch.Tensor) or not tensor.is_floating_point():
                raise TypeError(f"{name}: {getattr(tensor, 'dtype', type(tensor).__name__)}; a tensor in floating point")
        options = {"wavelength_nm": wavelength_nm, "clip": self._clip}
        given = [tensor.to(torch.float64) for tensor in (origins, directions)]
        return Landings(*_Traced.apply(self._sound(), *given, self._lens, self._all_names, options))  # type: ignore[no-untyped-call,unused-ignore]
