"""From evidence to a verdict: thresholds (`rules`), codes (`findings`) and the decision (`decide`).

Evidence is numbers. `decide(evidence, rules)` is pure: it returns a verdict and findings, each with a code,
a value, the bound it was held against and its subject. `trimtab.host.trace.sentences` alone makes sentences
of them, and nothing in the program reads a sentence.
"""
