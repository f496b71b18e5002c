"""Measured bore of a mesh that is one part of a pipeline; the module `mesh_parts` makes the measurements."""

from dataclasses import dataclass

from .axis import Axis


@dataclass(frozen=True)
class MeshBore:
    """Measured bore of a mesh that is one part of a pipeline."""

    file: str
    """Absolute path of the mesh file."""
    scale: float
    """Factor from the file's length unit to metres: 0.001 for mm."""
    axis: Axis
    """Centreline of the bore in the mesh's own coordinates, starting at the mesh's origin."""
    narrowest: float
    """Smallest clear width of the bore, measured through its axis [m]."""
    digest: str
    """Hash of the mesh file's content and of its scale."""
    places: tuple[float, ...]
    """Arc lengths at the middle of the stretches of the bore for which radii are stored, increasing [m]."""
    radii: tuple[float, ...]
    """Radii of circles with the mean cross-sectional areas of the bore's stretches [m]."""
    least: tuple[float, ...]
    """Radii of the largest circles about the axis that fit into all cross-sections of the bore's stretches [m]."""

    @property
    def ends(self) -> tuple[float, float]:
        """Diameters of the bore: first at its start, then at its end [m]."""
        return 2 * self.radii[0], 2 * self.radii[-1]
