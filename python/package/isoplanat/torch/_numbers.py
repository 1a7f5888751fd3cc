"""Numbers of a lens as parameters of a module."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import nn

from .._isoplanat import Lens


def replaced(lens: Lens, names: Sequence[str], values: torch.Tensor) -> Lens:
    """The lens with these numbers. Raises ValueError where they are no lens."""
    return lens.replace(dict(zip(names, values.detach().cpu().tolist(), strict=True)))


class Numbers(nn.Module):
    """A module whose parameters are numbers of a lens, kind by kind; they stay float64, whatever the module is cast to."""

    _lens: Lens

    def __init__(self, all_names: Sequence[str], values: Sequence[float], replan_every: int) -> None:
        if replan_every < 0:
            raise ValueError(f"replan_every: {replan_every}; 0 or more passes")
        super().__init__()
        groups: dict[str, list[int]] = {}
        for k, name in enumerate(all_names):
            groups.setdefault(name.rpartition(".")[2], []).append(k)
        self._all_names = list(all_names)
        self.names = {kind: [all_names[k] for k in of] for kind, of in groups.items()}
        numbers = {kind: nn.Parameter(torch.tensor([values[k] for k in of], dtype=torch.float64)) for kind, of in groups.items()}
        self.numbers = nn.ParameterDict(numbers)
        # Where each number of the library stands among the groups'.
        self._places = [k for of in groups.values() for k in of]
        self._order = sorted(range(len(self._places)), key=self._places.__getitem__)
        self.replan_every = replan_every
        # Passes in training since the last layout, and the numbers that it was for.
        self._passes, self._planned = 0, self._values().detach().clone()
        # Those of the last pass, which were a lens.
        self._valid = self._planned

    def replan(self) -> None:
        """Lays out anew for the numbers as they are."""
        raise NotImplementedError

    def get_extra_state(self) -> dict[str, Any]:
        """What a checkpoint holds beside the numbers: their names, the lens they are put into, and the numbers that things are laid out for."""
        return {"names": self._all_names, "lens": self._lens.to_toml(), "planned": self._planned.tolist(), "passes": self._passes}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Takes what `get_extra_state` gave. Raises ValueError where other numbers are trained, or the lens is another."""
        self._lens, self._passes = self._lens_of(state, "lens", self._lens), state["passes"]
        self._planned = torch.tensor(state["planned"], dtype=torch.float64)
        self._lay_out()

    def _lens_of(self, state: dict[str, Any], name: str, own: Lens) -> Lens:
        """A lens of a state, which is to train the same numbers of a lens with the same surfaces as ``own``."""
        if state["names"] != self._all_names:
            missing, foreign = (
                ", ".join(sorted(set(some) - set(others))) or "no others" for some, others in ((self._all_names, state["names"]), (state["names"], self._all_names))
            )
            raise ValueError(f"state_dict: numbers that are not trained here: {foreign}; trained here and not in it: {missing}")
        lens = Lens.from_toml(state[name], "state_dict")
        if list(lens.parameters) != list(own.parameters):
            raise ValueError(f"state_dict: of the lens {lens.name!r}; one with the surfaces of {own.name!r}")
        return lens

    def _gone_back(self, error: ValueError) -> ValueError:
        """The error of numbers that are no lens, which go back to those of the last pass; says how far they were from there."""
        values, kept = self._values().detach().cpu(), self._valid.cpu()
        if torch.equal(values, kept):
            return error
        by = (values - kept).abs() / kept.abs().clamp(min=max(1e-3 * float(kept.abs().max()), 1e-12))
        farthest = torch.nan_to_num(by, nan=torch.inf, posinf=torch.inf).argsort(descending=True).tolist()[:3]
        moved = ", ".join(f"{self._all_names[k]} from {float(kept[k]):.6g} to {float(values[k]):.6g}" for k in farthest if values[k] != kept[k])
        self._set(self._valid)
        return ValueError(f"{error}; the layer has the numbers of its last pass again; farthest moved since: {moved}")

    def _sound(self) -> torch.Tensor:
        """All numbers, which are a lens; where they are none they go back to those of the last pass, and ValueError says so."""
        values = self._values()
        try:
            replaced(self._lens, self._all_names, values)
        except ValueError as error:
            raise self._gone_back(error) from None
        self._valid = values.detach().clone()
        return values

    def _lay_out(self) -> None:
        """Lays out for the numbers of the last layout."""

    def _is_planned(self) -> bool:
        return torch.equal(self._values().detach().cpu(), self._planned.cpu())

    def _follow(self) -> None:
        """Lays out anew where that is due: after so many passes in training, whenever the numbers have changed in evaluation."""
        training = self.training and torch.is_grad_enabled()
        due = training and self.replan_every and self._passes >= self.replan_every
        if due or not self.training and not self._is_planned():
            self.replan()
        self._passes += training

    def _values(self) -> torch.Tensor:
        """All numbers in the library's order."""
        return torch.cat([self.numbers[kind] for kind in self.names])[self._order]

    def _gradient(self) -> torch.Tensor:
        """The gradient in that order; 0 where there is none."""
        # `ParameterDict` has its kinds in another order.
        numbers = [self.numbers[kind] for kind in self.names]
        grads = [torch.zeros_like(number) if number.grad is None else number.grad for number in numbers]
        return torch.cat(grads)[self._order].to(torch.float64)

    @torch.no_grad()
    def _set(self, values: torch.Tensor) -> None:
        """Puts numbers in the library's order in."""
        grouped, first = values[self._places], 0
        for kind in self.names:
            number = self.numbers[kind]
            number.copy_(grouped[first : first + len(number)])
            first += len(number)

    def _apply(self, fn: Callable[..., Any], recurse: bool = True) -> Any:
        kept = {kind: number.detach().clone() for kind, number in self.numbers.items()}
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call,unused-ignore]
        # To another device they go; other numbers they do not become.
        for kind, number in self.numbers.items():
            number.data = kept[kind].to(number.device)
            if number.grad is not None:
                number.grad = number.grad.to(torch.float64)
        return self
