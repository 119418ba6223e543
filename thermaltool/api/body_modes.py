"""A declared body in, its thermal modes out."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

from thermaltool.api.inputs import read_toml
from thermaltool.api.result import Result

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from thermaltool.model import Model
    from thermaltool.placement.body import SolidBody
    from thermaltool.placement.finite_elements import FiniteElements
    from thermaltool.placement.thermal_modes import ThermalEigenmodes

    BodyLike: TypeAlias = str | os.PathLike[str] | Mapping[str, Any]


@dataclass(frozen=True, repr=False)
class BodyModes(Result):
    """Thermal modes of a finite-element model.

    Attributes
    ----------
    modes : ThermalEigenmodes
        Time constants, shapes and weights.
    elements : FiniteElements
        The body and its mesh.
    name : str
    """

    modes: ThermalEigenmodes
    elements: FiniteElements
    name: str

    @property
    def body(self) -> SolidBody:
        """What was declared."""
        return self.elements.body

    @cached_property
    def model(self) -> Model:
        """The model document: every heat into every point and deflection by few modes.

        Raises
        ------
        ModelError
            Neither points nor deflections.
        """
        from thermaltool.placement.reduction import reduced_model

        return reduced_model(self.modes, self.body, {"body": self.name})

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before using the modes, each a sentence."""
        from thermaltool.report.thermal_modes import mode_notes

        return tuple(mode_notes(self.modes, self.body))

    @property
    def model_notes(self) -> tuple[str, ...]:
        """How far the model document is from the mesh, each a sentence; raises as `model`."""
        from thermaltool.report.thermal_modes import reduction_notes

        return tuple(reduction_notes(self.model))

    @property
    def frame(self) -> pandas.DataFrame:
        """One row for each mode: time constant, and the weight of every heat."""
        import pandas

        parts = {f"weight_{h}_pct": 100 * self.modes.relative_weights[:, k]
                  for k, h in enumerate(self.body.heat)}  # fmt: skip
        return pandas.DataFrame({"tau_s": self.modes.time_constants, **parts})

    def document(self) -> dict[str, Any]:
        """The modes as ``modes -o`` writes them."""
        from thermaltool.report.thermal_modes import mode_document

        return mode_document(self.modes, self.body)

    def table(self) -> str:
        """Time constants, weights, shapes at the points, and where the extremes are."""
        from thermaltool.report.thermal_modes import mode_table

        return mode_table(self.modes, self.body, self.name)

    def draw(self) -> Figure:
        """Shapes of the dominant modes with their deflection, and the weights."""
        from thermaltool.report.mode_shapes import draw_modes

        return draw_modes(self.modes, self.elements, self.name)


def thermal_modes(body: BodyLike, *, count: int | None = None) -> BodyModes:
    """Thermal modes of a body of finite elements: time constants, shapes, weights.

    Parameters
    ----------
    body : str, path or mapping
        A declaration (a TOML file, or what is in one): mesh, materials, convection, heat, points.
    count : int, optional
        Number of modes, the slowest first. Default: all of a small mesh, else 20.

    Returns
    -------
    BodyModes

    Raises
    ------
    ModelError
        A declaration or a mesh that cannot be read or that no heat leaves; a region or boundary
        that the mesh does not have.
    FitError
        Equations that cannot be solved.

    Examples
    --------
    >>> import thermaltool as tt
    >>> found = tt.thermal_modes({
    ...     "format": "thermaltool-body", "version": 1,
    ...     "mesh": {"rod": {"length": 1.0, "area": 0.0314, "elements": 22}},
    ...     "materials": {"steel": {"conductivity": 60.5, "density": 7800, "specific_heat": 434}},
    ...     "convection": {"side": 20},
    ...     "heat": {"Q_motor_W": {"on": "left"}},
    ... })
    >>> (found.modes.time_constants[:3] / 60).round(1).tolist()
    [141.0, 56.5, 20.1]
    """
    from thermaltool.errors import ModelError
    from thermaltool.placement.thermal_modes import thermal_modes as solve

    if count is not None and count < 1:
        raise ValueError(f"{count} modes: at least one")
    elements, name, source = finite_elements(body)
    try:
        equations = elements.equations()
    except ModelError as error:
        raise ModelError(f"{source}: {error}") from error
    return BodyModes(solve(equations, count), elements, name)


def finite_elements(body: BodyLike) -> tuple[FiniteElements, str, str]:
    """Mesh of a declaration, the name of the body, and where it is declared.

    Raises
    ------
    ModelError
        A declaration or a mesh that cannot be read.
    """
    from thermaltool.placement.declaration import load_body
    from thermaltool.placement.finite_elements import FiniteElements

    source, folder, document = "<body>", "", body
    if not isinstance(body, Mapping):
        source = os.fspath(body)
        folder, document = os.path.dirname(source), read_toml(source)
    assert isinstance(document, Mapping)

    def read_mesh(file: str, unit: float) -> Any:
        from thermaltool.api.mesh_file import read_mesh

        # A mesh is named as seen from the declaration.
        return read_mesh(os.path.join(folder, file), unit)

    elements = FiniteElements(load_body(document, source, read_mesh))
    title = document.get("name")
    default = os.path.splitext(os.path.basename(source))[0].strip("<>")
    return elements, title if isinstance(title, str) else default, source
