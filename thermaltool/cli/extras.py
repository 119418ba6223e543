"""Packages that commands need beyond numpy and click, and what installs them."""

from __future__ import annotations

from collections.abc import Sequence

# Import name -> the extra of this package that has it.
EXTRAS = {
    "scipy": "batch",
    "pyarrow": "batch",
    "pandas": "batch",
    "matplotlib": "plot",
    "mpl_toolkits": "plot",
    "skfem": "mesh",
    "meshio": "mesh",
    "h5py": "formats",
    "nptdms": "formats",
    "openpyxl": "formats",
    "piqp": "control",
}
# What a command will need next, too: named at once.
OF_COMMANDS = {"plant": "plants", "plot": "plot"}
OF_OPTIONS = {"--plot": "plot", "--report": "plot", "--figures": "plot"}
# Package indices call it so.
DISTRIBUTIONS = {"skfem": "scikit-fem", "mpl_toolkits": "matplotlib"}


def missing_package(name: str | None, command: str, arguments: Sequence[str]) -> str | None:
    """What a user can do about a package that is not there; None where no extra has it.

    Parameters
    ----------
    name : str or None
        Of the module that could not be imported.
    command : str
    arguments : sequence of str
        Of the command line.
    """
    package = (name or "").partition(".")[0]
    if package not in EXTRAS:
        return None
    options = {each.partition("=")[0] for each in arguments}
    extra = OF_COMMANDS.get(command, EXTRAS[package])
    if extra == "batch":
        extra = next((each for o, each in OF_OPTIONS.items() if o in options), extra)
    called = DISTRIBUTIONS.get(package, package)
    aside = "" if extra == "control" else " (streams do without)"
    return (
        f"needs {called}, which is not installed{aside}: "
        f"pip install 'thermaltool[{extra}]', or 'thermaltool[all]' for all commands"
    )
