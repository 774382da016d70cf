"""Tracing: from flight logs to the physical effect that the model lacks.

The packages and modules, from data to answer; `run` calls them:

- `data`: check which logs belong together, audit them, and cut them into segments on a regular grid.
- `parameters`, `evidence`, `search`: the scaled parameter space, the log evidence of sets of effects, and the
  search over sets.
- `segment_fit`: fit sets of effects to command-driven segments with free initial states.
- `flight_fit`: fit sets of effects to whole flights in closed loop; compare repeat flights.
- `selection`: search with one of the two fits and select a set.
- `residual`: what a model leaves unexplained. The verdict uses the residual of the selected set and that of
  the model without effects; the description and the network use only the latter.
- `gathering`, `decision`: the numbers that the verdict depends on, the rules, and the verdict with its
  findings.
- `uncertainty`, `prediction`, `next_flight`: intervals, errors on held-out flights, the proposed next flight.
- `assembly`, `result`, `answer`: the named effects, the result as typed data, and its JSON object.
- `sentences`, `words`: sentences for people, made from codes and numbers. The program never reads them.
"""
