"""Tracing: from flight logs to the physical effect that the model lacks.

The rooms, in the order in which a trace passes through them (`run`):

- `data`: which logs belong together, what they are worth, and segments on a regular grid.
- `parameters`, `evidence`, `search`: the scaled parameter space, evidence for sets of effects, and the search
  over sets.
- `segment_fit`: sets of effects fitted to command-driven segments from free initial states.
- `flight_fit`: the same over whole flights in closed loop, and what repeats between twin flights.
- `selection`: which of the two fits is searched, and what the search ends with.
- `residual`: what the selected set leaves, what that depends on, and a network on it.
- `gathering`, `decision`: the evidence as numbers, the rules, and the verdict with its findings.
- `uncertainty`, `prediction`, `next_flight`: intervals, errors on held-out flights, the flight to fly next.
- `assembly`, `result`, `answer`: what was found, and the JSON object of it.
- `sentences`, `words`: what people read; made from codes and numbers, read back by nothing.
"""
