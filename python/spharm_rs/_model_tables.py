"""Coefficients as tables with labels: pandas' frames and xarray's arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import convert
from ._arrays import Floats


def channel_names(channels: int, surface: bool) -> list[str]:
    """Returns the names of the channels: x, y and z of a surface, otherwise numbers from 0."""
    return list("xyz") if surface else [str(channel) for channel in range(channels)]


def to_frame(coefficients: Floats, surface: bool) -> Any:
    import pandas

    degrees, orders = convert.degrees_and_orders(convert.degree_of("coefficients", len(coefficients)))
    index = pandas.MultiIndex.from_arrays([degrees, orders], names=["degree", "order"])
    return pandas.DataFrame(coefficients, index=index, columns=channel_names(coefficients.shape[1], surface))


def to_xarray(coefficients: Floats, surface: bool) -> Any:
    import xarray

    degrees, orders = convert.degrees_and_orders(convert.degree_of("coefficients", len(coefficients)))
    coordinates = {
        "degree": ("harmonic", degrees),
        "order": ("harmonic", orders),
        "channel": channel_names(coefficients.shape[1], surface),
    }
    return xarray.DataArray(coefficients.copy(), coordinates, ("harmonic", "channel"), name="coefficients")


def of_table(table: Any) -> tuple[Floats, bool]:
    """Returns the coefficients, (K, c), of a frame or an array as written above, in any order of rows, and whether its
    channels are x, y and z, which are found by name. Rows that are absent are zero."""
    if hasattr(table, "dims"):
        if set(table.dims) != {"harmonic", "channel"}:
            raise ValueError(f"table: expected the dimensions harmonic and channel, found {', '.join(map(str, table.dims))}")
        table = table.transpose("harmonic", "channel")
        values, names = table.values, table.coords["channel"].values.tolist() if "channel" in table.coords else []
        missing = [name for name in ("degree", "order") if name not in table.coords]
        if missing:
            raise ValueError(f"table: expected the coordinates degree and order, found no {missing[0]}")
        degrees, orders = table.coords["degree"].values, table.coords["order"].values
    elif hasattr(table, "index") and hasattr(table, "columns"):
        levels = [str(name) for name in table.index.names]
        if not set(levels) & {"degree", "order"} and {"degree", "order"} <= set(table.columns):
            table, levels = table.set_index(["degree", "order"]), ["degree", "order"]
        if sorted(levels) != ["degree", "order"]:
            found = ", ".join(levels)
            raise ValueError(f"table: expected an index of degree and order, or columns of these names; found the index {found}")
        values, names = table.to_numpy(), list(table.columns)
        degrees, orders = (table.index.get_level_values(name).to_numpy() for name in ("degree", "order"))
    else:
        raise ValueError(f"table: expected a DataFrame or a DataArray, found {type(table).__name__}")
    if values.ndim != 2 or len(values) == 0:
        raise ValueError(f"table: expected shape (K, c), found {values.shape}")
    for name, numbers in (("degree", degrees), ("order", orders)):
        if numbers.dtype.kind not in "iu":
            raise ValueError(f"table: expected whole numbers in {name}, found {numbers.dtype}")
    degrees, orders = degrees.astype(np.int64), orders.astype(np.int64)
    bad = np.flatnonzero((degrees < 0) | (np.abs(orders) > degrees))
    if len(bad):
        found = f"degree {degrees[bad[0]]} and order {orders[bad[0]]}"
        raise ValueError(f"table, row {bad[0]}: expected an order from -l to l for degree l, found {found}")
    rows = degrees**2 + degrees + orders
    if len(np.unique(rows)) < len(rows):
        raise ValueError("table: expected each degree and order once, found duplicates")
    names = [str(name) for name in names]
    surface = sorted(names) == list("xyz")
    coefficients = np.zeros(((int(degrees.max()) + 1) ** 2, values.shape[1]))
    coefficients[rows] = values[:, [names.index(name) for name in "xyz"]] if surface else values
    return coefficients, surface
