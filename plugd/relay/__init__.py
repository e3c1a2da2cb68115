"""Wanted power to relay minutes. See `switching` for the rules, `delay` for the random delay."""

from plugd.relay.delay import delay_s
from plugd.relay.switching import RelayHistory, realise, slot_shares

__all__ = ["RelayHistory", "delay_s", "realise", "slot_shares"]
