"""Camera lenses in NumPy: exact rays, point spread functions, pictures through a lens, and gradients to every number of it.

>>> import isoplanat as iso
>>> lens = iso.Lens("cooke_triplet")
>>> lens.inspect()["effective_focal_length_mm"]
50.0213507194...

Units are mm unless a name says otherwise (``_um``, ``_nm``, ``_deg``). z runs along the light, y is up. Pictures are ``[3, row, col]``, linear light,
upright. What cannot be used raises ``ValueError`` with the argument or file, the place, what was found and what is allowed.
"""

from ._dataset import Dataset, dataset
from ._develop import develop
from ._isoplanat import (
    STATUS,
    Capture,
    Frame,
    Lens,
    Optimized,
    Plan,
    Psf,
    Rays,
    Record,
    Render,
    __version__,
    capture,
    lenses,
    read_picture,
    render,
    scene,
    set_threads,
    threads,
    write_picture,
)

__all__ = [
    "STATUS",
    "Capture",
    "Dataset",
    "Frame",
    "Lens",
    "Optimized",
    "Plan",
    "Psf",
    "Rays",
    "Record",
    "Render",
    "__version__",
    "capture",
    "dataset",
    "develop",
    "lenses",
    "read_picture",
    "render",
    "scene",
    "set_threads",
    "threads",
    "write_picture",
]
