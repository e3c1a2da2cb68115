"""Nights in which things fail: the daemon's own cycle in one process, ports that can be made to fail, the truth behind.

python -m tests.chaos --nights 2000 --pairs 500
"""
