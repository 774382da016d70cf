"""Kernels over lanes compiled for ARM's NEON and run by an emulator: the bits are those of this machine."""

from __future__ import annotations

import subprocess

import numpy as np

from trimtab.host.codegen.compiler import FLAGS, find_compiler
from trimtab.host.codegen.simd import PRELUDE
from trimtab.host.models.kernel import source
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi
from trimtab.host.vehicle import load_vehicle

MAIN = """
#include <stdio.h>
static double next(unsigned long *seed) {
    *seed = *seed * 6364136223846793005UL + 1442695040888963407UL;
    return (double)(*seed >> 11) / 4503599627370496.0 - 1.0;
}
static void show(V a) {
    for (int i = 0; i < LANES; ++i) {
        unsigned long long bits;
        double value = a[i];
        memcpy(&bits, &value, 8);
        printf("%llx\\n", bits);
    }
}
static V xi[WEIGHTS], x0[SIZE], drive[3 * ROWS], flight[15], samples[2 * SIZE];
static Stage stages[4];
static void fill(V *to, int count, double from, double size, unsigned long *seed) {
    for (int k = 0; k < count; ++k) for (int i = 0; i < LANES; ++i) to[k][i] = from + size * next(seed);
}
int main(void) {
    unsigned long seed = 1;
    for (int k = 0; k < 200; ++k) {
        V a, b;
        fill(&a, 1, 0.0, 30.0, &seed); fill(&b, 1, 0.0, 2.0, &seed);
        show(vsin(a)); show(vcos(a)); show(vexp(a)); show(vtanh(b)); show(vatan2(a, b)); show(vsqrt(vabs(a)));
    }
    fill(xi, WEIGHTS, 0.0, 0.3, &seed); fill(x0, SIZE, 0.5, 0.1, &seed);
    fill(drive, 3 * ROWS, 0.5, 0.1, &seed); fill(flight, 15, 0.01, 0.01, &seed);
    const double *weights = (double *)xi, *row = (double *)drive;
    roll_out(weights, x0, row, LANES, 0, flight, 0, 0, 1, 0.02, 1, 0, stages, SIZE, 1, samples);
    for (int k = 0; k < 2 * SIZE; ++k) show(samples[k]);
    return 0;
}
"""


def test_neon_gives_the_bits_of_this_machine(tmp_path, require):
    require("compiler")
    require("arm")
    layout = Layout(hidden=(5,))
    kernel = source(Phi(vehicle=load_vehicle("research"), estimator=False), layout)
    text = tmp_path / "main.c"
    text.write_text(f"{PRELUDE}{kernel}\n#define WEIGHTS {layout.size}\n{MAIN}")
    compiler = find_compiler()
    assert compiler is not None
    options = [flag for flag in FLAGS if flag not in ("-fPIC", "-shared")]

    def output(*command: str, emulator: tuple[str, ...] = ()) -> list[str]:
        program = tmp_path / "program"
        build = [*command, *options, "-static", "-o", str(program), str(text), "-lm"]
        subprocess.run(build, check=True, capture_output=True)
        done = subprocess.run([*emulator, str(program)], check=True, capture_output=True, text=True)
        return done.stdout.split()

    ours = output(*compiler.command, "-DLANES=2")
    assert len(ours) == 2 * (6 * 200 + 2 * 19)
    assert output("aarch64-linux-gnu-gcc", emulator=("qemu-aarch64",)) == ours
    values = np.array([int(bits, 16) for bits in ours], dtype=np.uint64).view(float)
    assert np.isfinite(values).all()
