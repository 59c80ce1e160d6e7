"""The check cases: which patch flies each on which machine, from where, and what is allowed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

Parameters = Mapping[str, float | str]


@dataclass(frozen=True)
class Flight:
    """How a case is flown on one kind of machine, and what is allowed."""

    patch: str
    tolerances: Mapping[str, float]
    parameters: Parameters = field(default_factory=dict)
    until_s: float | None = None  # rows beyond are left out
    trimmed: bool = False  # whether its trim is found first, all digital
    on: str | None = None  # all of it on this machine


@dataclass(frozen=True)
class Case:
    """A check case: its published run and who flies it; NASA's other runs of it, where there are any."""

    name: str
    file: str
    flights: Mapping[str, Flight]
    orbits: bool = False  # the first published row gives the initial values
    others: str = ""  # pattern of the files of all of NASA's tools


TURNING = {"euler_deg": 1.0, "rate_deg_s": 0.1}
FALLING = {"altitude_ft": 0.01, "velocity_ft_s": 1e-3, "longitude_deg": 1e-7}
ORBIT = {"position_m": 1e-2, "velocity_m_s": 1e-5, "attitude_deg": 1e-6, "rate_rad_s": 1e-10}
SHOT: Parameters = {"height_start": 0.0, "east_start": "1000 ft/s", "down_start": "-1000 ft/s"}
# A sphere of the weight of case 1 that does not turn; its rotation is on the analog machine, too.
SPHERE: Parameters = {
    **dict.fromkeys(("body.ixx", "body.iyy", "body.izz"), "3.6 slug*ft^2"),
    **dict.fromkeys(("body.p_start", "body.q_start", "body.r_start"), 0.0),
}
CYLINDER = {"ixx": 500.0, "iyy": 12250.0, "izz": 12250.0}
STATION = {
    "ixx": 1.02e8,
    "iyy": 0.91e8,
    "izz": 1.64e8,
    "ixy": 6.96e6,
    "ixz": 5.48e6,
    "iyz": -5.9e5,
    "gradient": 0.0,
}


def all_digital(
    patch: str, tolerances: Mapping[str, float], parameters: Parameters | None = None
) -> Flight:
    """The patch of the hybrid run with all of it on the digital machine, its words shown on time."""
    usual: Parameters = {"cycle": 0.01, "compute_time": 0.0}
    return Flight(patch, tolerances, {**usual, **(parameters or {})}, on="digital")


def atmospheric(number: str, tool: str, digital: Flight, split: Flight) -> Case:
    """A case in the air, compared with one of NASA's tools."""
    file, others = (f"nesc_atmos/atmos_{number}_sim_{which}.csv" for which in (tool, "*"))
    return Case(number.lstrip("0"), file, {"digital": digital, "hybrid": split}, others=others)


def orbital(number: str, body: Parameters) -> Case:
    """An orbital case."""
    digital = all_digital("orbiting_cylinder", ORBIT, {**body, "cycle": 1.0})
    split = Flight("orbiting_cylinder", {"attitude_deg": 0.5}, body, until_s=480.0)
    file = f"orbit_jeod/jeod_dyncomp_RUN_{number}.csv"
    return Case(f"orbital {number}", file, {"digital": digital, "hybrid": split}, orbits=True)


# The F-16's trim, compared with one found from the same tables by other means.
TRIM = {"pitch": ("deg", 2.638938), "elevator": ("deg", -3.23276), "power": ("percent", 13.8738)}
TRIMMED = {"trim_pitch_deg": 1e-4, "trim_elevator_deg": 1e-3, "trim_power_percent": 0.01}

CASES = (
    atmospheric(
        "01",
        "04",
        all_digital("cannonball", FALLING, {"coefficient": 0.0}),
        Flight("tumbling_brick", FALLING, {"damping": 0.0, **SPHERE}),
    ),
    atmospheric(
        "02",
        "04",
        all_digital("tumbling_brick", {"euler_deg": 1e-3, "rate_deg_s": 1e-4}, {"damping": 0.0}),
        Flight("tumbling_brick", TURNING, {"damping": 0.0}),
    ),
    atmospheric(
        "03",
        "05",
        all_digital("tumbling_brick", {"euler_deg": 2e-3, "rate_deg_s": 2e-4}),
        Flight("tumbling_brick", TURNING),
    ),
    atmospheric(
        "06",
        "04",
        all_digital("cannonball", {"altitude_ft": 0.02, "velocity_ft_s": 2e-3}),
        Flight("cannonball", {"altitude_ft": 1.0}),
    ),
    atmospheric(
        "09",
        "04",
        all_digital("cannonball", {"altitude_ft": 0.05, "velocity_ft_s": 2e-3}, SHOT),
        Flight("cannonball", {"altitude_ft": 5.0}, SHOT),
    ),
    orbital("2", STATION),
    orbital("10A", CYLINDER),
    # The F-16 from its DAVE-ML files.
    atmospheric(
        "11",
        "05",
        replace(
            all_digital(
                "parts/f16",
                {**TRIMMED, "altitude_ft": 0.05, "velocity_ft_s": 1e-3, "euler_deg": 1e-3},
            ),
            trimmed=True,
        ),
        Flight(
            "parts/f16",
            {"altitude_ft": 5.0, "pitch_deg": 0.05},
            until_s=30.0,
            trimmed=True,
        ),
    ),
)
