"""Applications on top of the library: the demo, the paper's studies, the benchmark, the doctor."""
