"""What every fault means to a household, and what to do about it: one row a code. Pure.

A fault's own text says what was seen this time; what is here is true of all that have its code.
"""

from typing import NamedTuple

from plugd.domain import Fault

NO_COVER = "no timer of its own: switched off, it stays off if plugd or the broker dies, and the car is not charged"
"""What is true of a plug without a dead-man, fault or not."""


class Known(NamedTuple):
    """A fault as people are told of it."""

    title: str
    remedy: str


KNOWN: dict[str, Known] = {
    "forecast": Known(
        "No new forecast",
        "Nothing for a day: it is fetched again by itself. Then look at the network, and at forecast.base_url.",
    ),
    "store": Known(
        "The disk does not take what is to be kept",
        "Look at the disk under state.dir: is it full, read-only, or worn out? Charging goes on; a restart forgets.",
    ),
    "plug_silent": Known(
        "The plug does not answer",
        "Look whether it has power and Wi-Fi, whether the broker runs, and whether plug.topic is its own.",
    ),
    "plug_refuses": Known(
        "The plug does not do what it is told",
        "Unplug it from the wall and plug it in again; look for a lock in its own settings (PowerLock, child lock).",
    ),
    "relay_stuck": Known(
        "The relay is stuck on",
        "To stop charging unplug the car or switch the socket off. Then replace the plug: its contacts are welded.",
    ),
    "plug_protects": Known(
        "The plug has switched itself off",
        "Unplug it, let it cool, feel plug, socket and cable: what is warm or discoloured has to be replaced.",
    ),
    "overcurrent": Known(
        "Too much current: switched off",
        "Look at plug, socket and cable. Then set the mode to off, and to smart again.",
    ),
    "no_current": Known(
        "The car takes nothing",
        "Look at the charge limit and the timer in the car, and at the cable at both ends.",
    ),
    "plug_meter": Known(
        "No energy meter",
        "Take a plug with a meter, or tell how full the battery is: here, from the hub, or with car.soc_topic.",
    ),
    "plug_dead_man": Known(
        "A dead plugd would leave the car uncharged",
        "Update the plug's firmware, or set its timer as docs/hardware.md says for its kind.",
    ),
    "plug_retained_command": Known(
        "An old command is kept at the broker",
        "Clear it (mosquitto_pub -r -n -t and the topic), and see that nobody publishes it retained again.",
    ),
    "meter": Known(
        "The meter does not count",
        "Unplug the plug and plug it in again, or reset its meter. Until then energy is reckoned as power x time.",
    ),
    "solver": Known(
        "The simple plan counts",
        "Nothing for a day: the simple plan is as clean. Then send what plugd dump says to whoever keeps plugd.",
    ),
    "clock": Known(
        "The clock is not set",
        "Look at the network and at timedatectl: without the time plugd charges at once, and enters nothing.",
    ),
    "fought_over": Known(
        "Something else switches this plug",
        "Stop the other one: an automation, a timer, an app. One plug wants one controller.",
    ),
    "weak_supply": Known(
        "The Raspberry Pi's supply is too weak",
        "Take the supply made for it, and nothing else on its USB: at too little voltage it stops, and cards break.",
    ),
    "taken_over": Known(
        "Another program has plugd's place at the broker",
        "Stop the other one: a second plugd, or a program with the same client id; or give them different names.",
    ),
    "safe_mode": Known(
        "It has ended again and again",
        "Look at the log for what ends it, and send that to whoever keeps plugd. Meanwhile it charges from 23 to 6.",
    ),
    "car_soc": Known(
        "The car's state of charge makes no sense",
        "Set soc_topic, soc_json_key and soc_unit under [car] to what the car says; mosquitto_sub -v shows that.",
    ),
    "soc_stale": Known(
        "The car no longer says how full it is",
        "Look whether its app or bridge still publishes to car.soc_topic; or tell how full it is here or at the hub.",
    ),
    "history": Known(
        "What was kept is lost",
        "Nothing this time. Should it happen again, replace the disk (SD card); plugd dump says what is still set.",
    ),
    "charger_hardware": Known("The charger has failed", "Have it looked at."),
    "charger_hot": Known("The charger is too hot", "Give it air. It goes on by itself when it has cooled."),
    "charger_mains": Known("The charger finds its mains wrong", "Look at its supply: fuse, cable, voltage."),
    "charger_battery": Known(
        "The charger finds no battery",
        "Look whether the car is plugged in, its contactor closed, and the poles the right way round.",
    ),
    "charger_over": Known(
        "The charger gave more than the battery bears",
        "Look at [can] max_voltage_v and max_current_a, and at the charger; then restart plugd.",
    ),
    "charger_two_masters": Known(
        "Something else tells the charger what to do",
        "Stop it, or take it off the CAN bus: two that command one charger end in its own protection.",
    ),
    "can_bus": Known(
        "The CAN bus does not work",
        "Look at its wires, at 120 ohm at both ends, and at interface, channel and bitrate under [can].",
    ),
    "can_babble": Known(
        "Something on the CAN bus babbles",
        "Find it by taking one device after the other off the bus; plugd reads on as well as it can.",
    ),
}  # fmt: skip


def title(fault: Fault) -> str:
    """Its name for people."""
    return KNOWN[fault.code].title if fault.code in KNOWN else fault.code.replace("_", " ").capitalize()


def remedy(fault: Fault) -> str:
    """What to do, in whole sentences."""
    return KNOWN[fault.code].remedy if fault.code in KNOWN else "Look at plugd's log."
