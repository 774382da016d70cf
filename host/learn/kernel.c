/* Gradient of paper Algorithm 1 over lanes. Behind rollout.c, which stores the stages, the functions products, seen_back
   and given_back, the sizes THETA and MEASURED and the layers' calls BACKWARD, GRADIENTS. */

/* Adds lane by lane, so a sum over all groups is in the order of the segments for any LANES. */
INLINE void add_lanes(double *sum, V a) {
    for (int i = 0; i < LANES; ++i) *sum += a[i];
}

/* Costates of the arguments of the units in a stage, then of the network's outputs. */
typedef V Costates[UNITS + GIVEN];

/* Columns i to i + IN - 1 of rows j to j + OUT - 1 in products_of. */
#define BLOCK(OUT, IN) { \
        V s[OUT][IN]; \
        for (int q = 0; q < OUT; ++q) for (int p = 0; p < IN; ++p) s[q][p] = row[q * (inputs + 1) + i + p]; \
        for (long k = 0; k < count; ++k) { \
            const V *u = stages[k].u + u0 + i, *b = costates[k] + b0 + j; \
            for (int q = 0; q < OUT; ++q) for (int p = 0; p < IN; ++p) s[q][p] += b[q] * u[p]; \
        } \
        for (int q = 0; q < OUT; ++q) for (int p = 0; p < IN; ++p) row[q * (inputs + 1) + i + p] = s[q][p]; \
    }
#define ROWS_OF(OUT) \
    for (; j + OUT <= outputs; j += OUT) { \
        V *row = gradient + (long)j * (inputs + 1); \
        int i = 0; \
        for (; i + 4 <= inputs; i += 4) BLOCK(OUT, 4) \
        for (; i < inputs; ++i) BLOCK(OUT, 1) \
        for (int q = 0; q < OUT; ++q) \
            for (long k = 0; k < count; ++k) row[q * (inputs + 1) + inputs] += costates[k][b0 + j + q]; \
    }
/* gradient[j][i] += sum over `count` stages of back[j] u[i]; the last column is the bias's. */
static void products_of(V *gradient, const Stage *stages, Costates *costates, long count, int u0, int b0, int inputs,
                        int outputs) {
    int j = 0;
    ROWS_OF(2)
    ROWS_OF(1)
}

/* Adds back' d(rate)/dx to out and back' d(rate)/dtheta to theta_back; units: the layers' costates. */
INLINE void pull_back(const double *xi, Stage *s, const V *drive, const V *flight, const V *theta, const V *back,
                      V *out, V *theta_back, V *units) {
    V d[GIVEN], of_x[SIZE], of_d[GIVEN], of_theta[THETA + 1], of_state[6], to[SEEN + UNITS];
    acceleration(s, 0, d);
    products(s->x, drive, flight, theta, d, back, of_x, of_d, of_theta);
    given_back(s->x + 3, s->u + SEEN + UNITS, of_d, of_state, units + UNITS);
    for (int i = 0; i < SIZE; ++i) out[i] += of_x[i];
    for (int i = 0; i < 6; ++i) out[3 + i] += of_state[i];
    for (int i = 0; i < THETA; ++i) theta_back[i] += of_theta[i];
    BACKWARD
    seen_back(s->x + 3, to, of_state);
    for (int i = 0; i < 6; ++i) out[3 + i] += of_state[i];
}

/* Steps whose stages are still in the cache when their products are added to the gradient. */
#define STEPS_AT_ONCE 4

/* After roll_out to `states` (1 + steps / every, SIZE): the loss is half of weight[i] (state[i] - measured[i])^2, summed
   over measured (1 + steps / every, MEASURED) except its first row. costate: the loss's slope by the start. by_lane: room
   for the gradient of each lane. */
void adjoint(const double *xi, const V *drive, const V *flight, const V *theta, long steps, double h, long every,
             Stage *stages, const V *states, const V *measured, const V *weight, V *costate, V *by_lane,
             double *gradient, V *theta_back) {
    Costates costates[4 * STEPS_AT_ONCE];
    memset(by_lane, 0, sizeof(V) * WEIGHTS);
    memset(costate, 0, sizeof(V) * SIZE);
    memset(theta_back, 0, sizeof(V) * THETA);
    for (long k = steps; k-- > 0;) {
        V before[SIZE], later[SIZE], back[SIZE];
        long node = (k + 1) / every;
        if ((k + 1) % every == 0)
            for (int i = 0; i < MEASURED; ++i)
                costate[i] += weight[i] * (states[node * SIZE + i] - measured[node * MEASURED + i]);
        memcpy(before, costate, sizeof before);
        for (int q = 3; q >= 0; --q) {
            for (int i = 0; i < SIZE; ++i) {
                back[i] = h * WEIGHT[q] * costate[i];
                if (q < 3) back[i] += h * ALONG[q + 1] * later[i];
            }
            memset(later, 0, sizeof later);
            pull_back(xi, stages + 4 * k + q, drive + (2 * k + HALF(q)) * ROWS, flight, theta, back, later, theta_back,
                      costates[4 * (k % STEPS_AT_ONCE) + q]);
            for (int i = 0; i < SIZE; ++i) before[i] += later[i];
        }
        memcpy(costate, before, sizeof before);
        if (k % STEPS_AT_ONCE == 0) {
            Stage *first = stages + 4 * k;
            long count = 4 * (steps - k < STEPS_AT_ONCE ? steps - k : STEPS_AT_ONCE);
            GRADIENTS
        }
    }
    for (int i = 0; i < WEIGHTS; ++i) add_lanes(gradient + i, by_lane[i]);
}
