"""One fit of a structure that is named."""

from __future__ import annotations

from thermaltool.fitting.data import TrainingData
from thermaltool.fitting.transfer.model import TransferModel
from thermaltool.fitting.transfer.orders import Orders
from thermaltool.fitting.transfer.registry import structure_of


def orders_of(
    name: str, nb: tuple[int, ...], nf: int | tuple[int, ...], nk: tuple[int, ...]
) -> Orders:
    """Orders of a structure by its name; see `Structure.orders`."""
    return structure_of(name).orders(nb, nf, nk)


def identify(
    data: TrainingData, name: str, orders: Orders, nc: int = 1, nd: int = 1, real: bool = False
) -> TransferModel:
    """Fit a structure of given orders by its name; see `structure_of` and `Structure.fit`."""
    return structure_of(name, (nc, nd), real).fit(data, orders)
