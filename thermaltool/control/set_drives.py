"""The drives that a controller sets, as its laws take them: held from line to line, and prompt.

A calibration may take a measured power for straight from row to row, and a response of it for one
behind a dead time (a surface that warms before what is behind it does). What is set stays until the
next line, and a law knows of no heat on its way: the dead time becomes lags
(`thermaltool.estimation.delay_lags`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from thermaltool.errors import ModelError
from thermaltool.estimation.delay_lags import with_lags
from thermaltool.estimation.estimator import load_estimator
from thermaltool.estimation.known_inputs import KnownInputEstimator
from thermaltool.model import Model
from thermaltool.responses.delay import DelayedModes
from thermaltool.responses.parallel import InputPath


def with_set_drives(model: Model, channels: Collection[str]) -> tuple[Model, tuple[str, ...]]:
    """A model whose estimator takes these drives as they are set, and what that costs.

    Parameters
    ----------
    model : Model
        With a design.
    channels : collection of str
        Drives that are set.

    Returns
    -------
    model : Model
        The same one where nothing is changed.
    notes : tuple of str
        A sentence for each output with a dead time that is now lags.

    Raises
    ------
    ModelError
        No design; a dead time that is too long for lags.
    """
    design = model.estimator_design()
    estimator = load_estimator(dict(design))
    if not isinstance(estimator, KnownInputEstimator):
        return model, ()
    to_sensors, near = _prompt(estimator.to_sensors, estimator.inner.sensors)
    to_outputs, nearer = _prompt(estimator.to_outputs, estimator.outputs)
    known = tuple(
        replace(each, hold="zero") if each.channel in channels else each for each in estimator.known
    )
    changed = replace(estimator, known=known, to_sensors=to_sensors, to_outputs=to_outputs)
    drives = tuple(
        replace(each, hold="zero") if each.channel in channels else each for each in model.drives
    )
    return (
        replace(model, drives=drives, design={**design, "known": changed.document()["known"]}),
        (*near, *nearer),
    )


def _prompt(
    paths: Sequence[InputPath], names: Sequence[str]
) -> tuple[tuple[InputPath, ...], tuple[str, ...]]:
    """Paths without a dead time, and a sentence for each that had one."""
    found: list[InputPath] = []
    notes = []
    for target, source, path in paths:
        if not isinstance(path, DelayedModes):
            found.append((target, source, path))
            continue
        try:
            lags, error = with_lags(path)
        except ModelError as refused:
            raise ModelError(
                f"{names[target]}: {refused}: a controller of heaters takes none"
            ) from refused
        found.append((target, source, lags))
        notes.append(
            f"{names[target]}: a dead time of {path.delay:.3g} s stands as lags, within "
            f"{error:.2g} of the response to a step"
        )
    return tuple(found), tuple(notes)
