"""A lens for PyTorch: as a layer whose numbers are trained, with steps that know what a lens is, kernels, rays, a sensor, and pairs for a network.

Needs ``torch``, which ``import isoplanat`` does not. The optics run on the CPU; tensors come and go on their own devices.
"""

from ._layer import Fineness, LensLayer
from ._pairs import PairDataset
from ._psf import PsfLayer
from ._rays import Landings, RayLayer
from ._sensor import Sensor
from ._steps import LensSteps, Step

__all__ = ["Fineness", "Landings", "LensLayer", "LensSteps", "PairDataset", "PsfLayer", "RayLayer", "Sensor", "Step"]
