"""The JSON of a Tasmota plug, and how it counts time. Times in it are local and carry no offset, as they are."""

from datetime import datetime, timedelta
from typing import Any
from zoneinfo import ZoneInfo

from plugd_hil.outlet import Meter

VOLTAGE_V = 230.0


def pulse_span(pulse: int) -> timedelta:
    """PulseTime: 1..111 are tenths of a second, more are seconds + 100."""
    return timedelta(seconds=pulse - 100) if pulse > 111 else timedelta(milliseconds=100 * pulse)


def pulse_left(left: timedelta) -> int:
    """What is left of it, as it is told."""
    left_s = left.total_seconds()
    return int(left_s) + 100 if left_s > 11.1 else int(10.0 * left_s)


def local(moment: datetime) -> str:
    """As the firmware writes it."""
    return moment.strftime("%Y-%m-%dT%H:%M:%S")


def state_document(now: datetime, up: timedelta, on: bool) -> dict[str, Any]:
    """`tele/STATE`, and what `Status 11` holds; `now` in the plug's own time zone."""
    clock = f"{up.days}T{up.seconds // 3600:02}:{up.seconds // 60 % 60:02}:{up.seconds % 60:02}"
    return {
        "Time": local(now), "Uptime": clock, "UptimeSec": int(up.total_seconds()), "Heap": 25,
        "SleepMode": "Dynamic", "Sleep": 50, "LoadAvg": 19, "MqttCount": 1, "POWER": "ON" if on else "OFF",
        "Wifi": {"AP": 1, "SSId": "home", "Channel": 6, "Mode": "11n", "RSSI": 78, "Signal": -61,
                 "LinkCount": 1, "Downtime": "0T00:00:03"},
    }  # fmt: skip


def sensor_document(meter: Meter, power_w: float, zone: ZoneInfo) -> dict[str, Any]:
    """`tele/SENSOR`, and what `Status 8` and `Status 10` hold."""
    return {
        "Time": local(meter.now.astimezone(zone)),
        "ENERGY": {
            "TotalStartTime": local(meter.started.astimezone(zone)), "Total": round(meter.total_kwh, 3),
            "Yesterday": round(meter.yesterday_kwh, 3), "Today": round(meter.today_kwh, 3),
            "Power": round(power_w), "ApparentPower": round(power_w), "ReactivePower": 0,
            "Factor": 1.0 if power_w else 0.0, "Voltage": round(VOLTAGE_V),
            "Current": round(power_w / VOLTAGE_V, 3),
        },
    }  # fmt: skip
