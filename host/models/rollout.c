/* Roll-outs over lanes (paper eq. 7). Behind simd.h, rk4.h, layers.h and the functions phi and phi_constants, the sizes SIZE, ROWS and
   NETWORK, which is 0 or 1. With a network, the functions seen and given, the sizes SEEN and UNITS, and the layers'
   call FORWARD. */

#define GIVEN 3

#if NETWORK
/* One evaluation of the slope; u: inputs of every layer, then the network's outputs; back: room for their costates. */
typedef struct { V x[SIZE], u[SEEN + UNITS + GIVEN]; } Stage;
#else
typedef struct { V x[SIZE]; } Stage;
#endif

/* The acceleration of a stage: the network's, after its layers, and `push`, which may be 0. */
INLINE void acceleration(Stage *s, const V *push, V *d) {
#if NETWORK
    given(s->x + 3, s->u + SEEN + UNITS, d);
#else
    for (int i = 0; i < GIVEN; ++i) d[i] = splat(0.0);
#endif
    if (push) for (int i = 0; i < GIVEN; ++i) d[i] += push[i];
}

INLINE void slope_of(const double *xi, Stage *s, const V *drive, const V *flight, const V *theta, const V *push,
                     const V *constants, V *slope) {
    V d[GIVEN];
#if NETWORK
    seen(s->x + 3, s->u);
    FORWARD
#endif
    acceleration(s, push, d);
    phi(s->x, drive, flight, theta, d, slope, constants);
}

/* Drive: (2 steps + 1, ROWS, flights) at starts, middles and ends; `of`: each lane's flight, 0 for as many flights
   as lanes in their order. push (2 steps + 1, GIVEN): acceleration or 0. keep: stages (4 steps,) for an adjoint, else
   their room of 4 is used again. samples (1 + steps / every, rows) are `stride` vectors apart. */
void roll_out(const double *xi, const V *x0, const double *drive, long flights, const long *of, const V *flight,
              const V *theta, const V *push, long steps, double h, long every, int keep, Stage *stages, long rows,
              long stride, V *samples) {
    V x[SIZE], slope[SIZE], total[SIZE], gathered[ROWS], constants[PHI_CONSTANTS];
    phi_constants(flight, theta, constants);
    int same = of != 0;
    for (int l = 1; l < LANES && same; ++l) same = of[l] == of[0];
    memcpy(x, x0, sizeof x);
    for (long i = 0; i < rows; ++i) samples[i * stride] = x[i];
    for (long k = 0; k < steps; ++k) {
        for (int q = 0; q < 4; ++q) {
            Stage *s = stages + (keep ? 4 * k + q : q);
            long half = 2 * k + HALF(q);
            const double *row = drive + half * ROWS * flights;
            if (of && (q == 1 || q == 3 || half == 0))
                for (int i = 0; i < ROWS; ++i, row += flights)
                    if (same) gathered[i] = splat(row[of[0]]);
                    else for (int l = 0; l < LANES; ++l) gathered[i][l] = row[of[l]];
            rk4_at(SIZE, q, splat(h), x, slope, s->x);
            slope_of(xi, s, of ? gathered : (const V *)row, flight, theta, push ? push + half * GIVEN : 0, constants,
                     slope);
            for (int i = 0; i < SIZE; ++i) total[i] = (q ? total[i] : splat(0.0)) + WEIGHT[q] * slope[i];
        }
        for (int i = 0; i < SIZE; ++i) x[i] += h * total[i];
        if ((k + 1) % every == 0)
            for (long i = 0; i < rows; ++i) samples[((k + 1) / every * rows + i) * stride] = x[i];
    }
}

/* Roll-outs of `groups` groups, one after the other, whose arrays follow each other; `constants`, `parameters`: rows
   of flight and theta, which has no groups if parameters is 0. Samples are all states after each `every` steps. */
void roll_out_groups(long groups, const double *xi, const V *x0, const double *drive, const V *flight, long constants,
                     const V *theta, long parameters, const V *push, long steps, double h, long every, Stage *stages,
                     V *samples) {
    for (long g = 0; g < groups; ++g)
        roll_out(xi, x0 + g * SIZE, drive + g * (2 * steps + 1) * ROWS * LANES, LANES, 0, flight + g * constants,
                 theta + g * parameters, push + g * (2 * steps + 1) * GIVEN, steps, h, every, 0, stages, SIZE, 1,
                 samples + g * (steps / every + 1) * SIZE);
}

long stage_bytes(void) { return sizeof(Stage); }
