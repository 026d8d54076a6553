"""Positions of a record in metres, which tests think in; the record has latitude and longitude."""

from typing import Any

import numpy as np

from insdvl.navigation.geometry import earth, odom
from insdvl.navigation.odometry import position_in_odom as position


def origin_of(nav: Any) -> np.ndarray:
    """Latitude, longitude, height of the origin (3,)."""
    return np.array([nav["lat_0"], nav["lon_0"], nav["h_0"]])


def place(nav: Any, p_o: Any) -> np.ndarray:
    """The place (3,) at a position in odom."""
    found = odom.place_of(np.asarray(p_o, dtype=float), origin_of(nav))
    assert found is not None
    return found


def put(nav: Any, p_o: Any, r_o: Any = (0.0, 0.0, 0.0)) -> None:
    """Set position and reference of a group ``nav`` by their positions in odom."""
    nav["llh"], nav["llh_r"] = place(nav, p_o), place(nav, r_o)


def moved(llh: Any, d_n: Any) -> np.ndarray:
    """The place (3,) that is so many metres north, east and down of another."""
    out = np.array(llh)
    earth.move(out, np.asarray(d_n, dtype=float))
    return out


__all__ = ["moved", "origin_of", "place", "position", "put"]
