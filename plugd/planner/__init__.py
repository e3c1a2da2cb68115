"""The planner: least carbon over the next sessions, every bound kept, every plan certified.

`problem` says what is asked and answered. `bounds` makes any problem feasible; `exact` solves it by sorting,
without numpy; `qp` solves it with OSQP (`condensed` is the form, `prices` the start) and checks it by `exact`.
"""
