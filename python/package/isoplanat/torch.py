"""A lens as a layer of PyTorch: what it makes of patches of scenes, with the gradient of one's own loss by the lens's numbers.

Needs ``torch``, which ``import isoplanat`` does not. The optics run on the CPU; tensors come and go on their own devices.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from torch import nn
from torch.autograd.function import once_differentiable

from ._isoplanat import Frame, Layer, Lens

__all__ = ["LensLayer"]


class _Through(torch.autograd.Function):
    """Numbers and scenes to captures and truths; constant memory beside the patches' own."""

    @staticmethod
    def forward(
        ctx: Any, values: torch.Tensor, scenes: torch.Tensor, core: Layer, distances: list[int], places: list[tuple[int, int]], margin: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        given = scenes.detach().cpu().contiguous().numpy()
        captures, truths, ctx.record = core.record(values.detach().cpu().numpy(), given, distances, places, margin)
        ctx.device = values.device
        return torch.from_numpy(captures).to(scenes.device), torch.from_numpy(truths).to(scenes.device)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator]
    def backward(ctx: Any, captures_bar: torch.Tensor, truths_bar: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        bars = [bar.detach().cpu().contiguous().numpy() for bar in (captures_bar, truths_bar)]
        return torch.from_numpy(ctx.record.vjp(*bars)).to(ctx.device), None, None, None, None, None


class LensLayer(nn.Module):
    """Patches of scenes through a lens whose numbers are trained: ``captures, truths = layer(scenes, distance_mm, place)``.

    Parameters
    ----------
    lens : Lens
    frame : Frame, optional
        The lens's own raster where left out.
    distances_mm : float or sequence of float, optional
        Object distances that scenes may stand at; the lens's own where left out.
    trainable : str or sequence of str
        Names or patterns of the lens's numbers, such as "surface[*].curvature" or "surface[2].a4".
    illuminant : str, optional
        As of `isoplanat.render`.
    replan_every : int
        After so many forward passes in training, kernels are laid out anew for the lens as it is by then, and scenes are placed anew. 0: never.

    Attributes
    ----------
    numbers : torch.nn.ParameterDict
        The trained numbers by kind ("curvature", "thickness", …), float64 [n], in mm, 1/mm and so on. They stay float64, whatever the module is cast to.
    names : dict of list of str
        Their names, kind by kind, as in `Lens.parameters`.
    """

    def __init__(
        self,
        lens: Lens,
        frame: Frame | None = None,
        *,
        distances_mm: float | Sequence[float] | None = None,
        trainable: str | Sequence[str] = ("surface[*].curvature",),
        illuminant: str | None = None,
        replan_every: int = 25,
    ) -> None:
        super().__init__()
        self._core = Layer(lens, frame, distances_mm, trainable, illuminant)
        self.replan_every = replan_every
        self._passes, self._stale = 0, False
        all_names, values = self._core.names, self._core.values
        groups: dict[str, list[int]] = {}
        for k, name in enumerate(all_names):
            groups.setdefault(name.rpartition(".")[2], []).append(k)
        self.names = {kind: [all_names[k] for k in of] for kind, of in groups.items()}
        numbers = {kind: nn.Parameter(torch.tensor([values[k] for k in of], dtype=torch.float64)) for kind, of in groups.items()}
        self.numbers = nn.ParameterDict(numbers)
        # Where each number of the library stands among the groups'.
        places = [k for of in groups.values() for k in of]
        self._order = sorted(range(len(places)), key=places.__getitem__)

    @property
    def distances_mm(self) -> list[float]:
        """Object distances, mm."""
        return self._core.distances_mm

    @property
    def frame(self) -> Frame:
        """The sensor."""
        return self._core.frame

    @property
    def reach_px(self) -> int:
        """How far the light of a pixel comes from, at most: a margin of so many texels leaves no pixel that sees past its scene."""
        return self._core.reach_px

    @property
    def lens(self) -> Lens:
        """The lens as it is now. Raises ValueError where its numbers are no lens."""
        return self._core.lens(self._values().detach().cpu().numpy())

    def _values(self) -> torch.Tensor:
        return torch.cat([self.numbers[kind] for kind in self.names])[self._order]

    def replan(self) -> None:
        """Lays kernels out for the lens as it is now, and places scenes before it."""
        self._core = self._core.replanned(self._values().detach().cpu().numpy())
        self._passes, self._stale = 0, False

    def _which(self, distance_mm: Any, count: int) -> list[int]:
        known = self.distances_mm
        if distance_mm is None:
            asked = [known[0]] * count
        elif isinstance(distance_mm, int | float):
            asked = [float(distance_mm)] * count
        else:
            asked = [float(d) for d in distance_mm]
        found = []
        for d in asked:
            near = min(range(len(known)), key=lambda k: abs(1 / known[k] - 1 / d) if d else 1.0)
            if not d or not abs(1 / known[near] - 1 / d) <= 1e-6 * abs(1 / d) + 1e-15:
                raise ValueError(f"distance_mm: {d:g}; one of {', '.join(f'{k:g}' for k in known)} (distances_mm of the layer)")
            found.append(near)
        return found

    @torch.compiler.disable  # type: ignore[untyped-decorator,unused-ignore]
    def forward(
        self, scenes: torch.Tensor, distance_mm: Any = None, place: Any = None, *, margin: int = 0
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Captures and truths, both [B, 3, H - 2 margin, W - 2 margin], on the scenes' device.

        Parameters
        ----------
        scenes : tensor [B, 3, H, W]
            Linear light, upright; a texel is a pixel in the middle of the patch; texels are kept as float32. Scenes of float64 are rendered in
            float64, all others in float32. They have no gradient here. What lies beyond a scene goes on with its border.
        distance_mm : float, or tensor or sequence [B], optional
            Each one of the layer's distances; the first where left out.
        place : tensor or sequence [B, 2], optional
            Row and column of each patch's first pixel in the frame; the middle where left out.
        margin : int
            Texels on each side that only the blur sees.
        """
        if scenes.ndim != 4 or scenes.shape[1] != 3 or not len(scenes):
            raise ValueError(f"scenes: shape {tuple(scenes.shape)}; [B, 3, H, W] with one or more")
        if scenes.requires_grad:
            raise ValueError("scenes: they ask for a gradient, and have none here; scenes.detach()")
        if not scenes.is_floating_point():
            raise TypeError(f"scenes: {scenes.dtype}; linear light in floating point")
        count, _, rows, columns = scenes.shape
        if not 0 <= 2 * margin < min(rows, columns):
            raise ValueError(f"margin: {margin}; 0 to less than half of {rows} rows and {columns} columns")
        rows, columns = rows - 2 * margin, columns - 2 * margin
        frame = self.frame
        if rows > frame.rows or columns > frame.columns:
            raise ValueError(f"scenes: patches of {rows} × {columns} pixels; at most the frame, {frame.rows} × {frame.columns}")
        if place is None:
            places = [((frame.rows - rows) // 2, (frame.columns - columns) // 2)] * count
        else:
            asked = [(float(row), float(column)) for row, column in place]
            if any(at < 0 or at % 1 for both in asked for at in both):
                found = next(both for both in asked if any(at < 0 or at % 1 for at in both))
                raise ValueError(f"place: {found}; whole rows and columns from 0, within {frame.rows} and {frame.columns}")
            places = [(int(row), int(column)) for row, column in asked]
        training = self.training and torch.is_grad_enabled()
        if self._stale or training and self.replan_every and self._passes >= self.replan_every:
            self.replan()
        self._passes += training
        with torch.autocast(scenes.device.type, enabled=False):
            given = scenes if scenes.dtype == torch.float64 else scenes.float()
            through: tuple[torch.Tensor, torch.Tensor] = _Through.apply(  # type: ignore[no-untyped-call]
                self._values(), given, self._core, self._which(distance_mm, count), places, margin
            )
        return through

    def _apply(self, fn: Callable[..., Any], recurse: bool = True) -> "LensLayer":
        kept = {kind: number.detach().clone() for kind, number in self.numbers.items()}
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call]
        # To another device they go; other numbers they do not become.
        for kind, number in self.numbers.items():
            number.data = kept[kind].to(number.device)
            if number.grad is not None:
                number.grad = number.grad.to(torch.float64)
        return self

    def _load_from_state_dict(self, *arguments: Any, **options: Any) -> None:
        super()._load_from_state_dict(*arguments, **options)  # type: ignore[no-untyped-call]
        # The numbers come behind this.
        self._stale = True

    def extra_repr(self) -> str:
        """For ``print(layer)``."""
        trained: Iterable[str] = (f"{len(of)} {kind}" for kind, of in self.names.items())
        return f"{', '.join(trained)}; {len(self.distances_mm)} distances, frame {self.frame.columns} × {self.frame.rows}"
