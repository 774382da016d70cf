"""From numbers to a verdict: thresholds (`rules`), codes (`findings`) and the decision (`decide`).

The inputs are numbers. `decide(inputs, rules)` is a pure function: it returns a verdict and findings. Each
finding has a code, a value, the bound that the value was compared with, and a subject. Only
`trimtab.host.trace.sentences` turns findings into sentences; the program never reads a sentence.
"""
