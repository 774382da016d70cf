"""How well a model predicts flights, and what differs between two artefacts of the same kind.

`prediction` has `predict`, for `trimtab predict`. `comparison` has `compare`, for `trimtab compare`.
"""
