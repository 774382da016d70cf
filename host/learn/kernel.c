/* Gradient of paper Algorithm 1 over lanes. Behind rollout.c, which stores the stages, the functions products, seen_back
   and given_back, the sizes THETA and MEASURED and the layers' calls BACKWARD, GRADIENTS. */

/* Adds lane by lane, so a sum over all groups is in the order of the segments for any LANES. */
INLINE void add_lanes(double *sum, V a) {
    for (int i = 0; i < LANES; ++i) *sum += a[i];
}

/* gradient[j][i] += sum over stages and lanes of back[j] u[i]; the last column is the bias's. */
static void products_of(double *gradient, const Stage *stages, long count, int u0, int b0, int inputs, int outputs) {
    for (int j = 0; j < outputs; j += 4) {
        int nj = outputs - j < 4 ? outputs - j : 4;
        for (int i = 0; i < inputs; i += 4) {
            int ni = inputs - i < 4 ? inputs - i : 4;
            V s[4][4];
            memset(s, 0, sizeof s);
            if (nj == 4 && ni == 4) {
                for (long k = 0; k < count; ++k) {
                    const V *u = stages[k].u + u0 + i, *b = stages[k].back + b0 + j;
                    for (int q = 0; q < 4; ++q) for (int p = 0; p < 4; ++p) s[q][p] += b[q] * u[p];
                }
            } else {
                for (long k = 0; k < count; ++k) {
                    const V *u = stages[k].u + u0 + i, *b = stages[k].back + b0 + j;
                    for (int q = 0; q < nj; ++q) for (int p = 0; p < ni; ++p) s[q][p] += b[q] * u[p];
                }
            }
            for (int q = 0; q < nj; ++q) for (int p = 0; p < ni; ++p)
                add_lanes(gradient + (long)(j + q) * (inputs + 1) + i + p, s[q][p]);
        }
        for (int q = 0; q < nj; ++q) {
            V s = splat(0.0);
            for (long k = 0; k < count; ++k) s += stages[k].back[b0 + j + q];
            add_lanes(gradient + (long)(j + q) * (inputs + 1) + inputs, s);
        }
    }
}

/* Adds back' d(rate)/dx to out and back' d(rate)/dtheta to theta_back; what came back to the layers is kept. */
INLINE void pull_back(const double *xi, Stage *s, const V *drive, const V *flight, const V *theta, const V *back,
                      V *out, V *theta_back) {
    V d[GIVEN], of_x[SIZE], of_d[GIVEN], of_theta[THETA + 1], of_state[6], to[64];
    acceleration(s, 0, d);
    products(s->x, drive, flight, theta, d, back, of_x, of_d, of_theta);
    given_back(s->x + 3, s->u + SEEN + UNITS, of_d, of_state, s->back + UNITS);
    for (int i = 0; i < SIZE; ++i) out[i] += of_x[i];
    for (int i = 0; i < 6; ++i) out[3 + i] += of_state[i];
    for (int i = 0; i < THETA; ++i) theta_back[i] += of_theta[i];
    BACKWARD
    seen_back(s->x + 3, to, of_state);
    for (int i = 0; i < 6; ++i) out[3 + i] += of_state[i];
}

/* After roll_out. pull (steps + 1, MEASURED) is the loss's slope by the states; costate: by the start. */
void adjoint(const double *xi, const V *drive, const V *flight, const V *theta, long steps, double h, Stage *stages,
             const V *pull, V *costate, double *gradient, V *theta_back) {
    memset(costate, 0, sizeof(V) * SIZE);
    memset(theta_back, 0, sizeof(V) * THETA);
    for (long k = steps; k-- > 0;) {
        V before[SIZE], later[SIZE], back[SIZE];
        for (int i = 0; i < MEASURED; ++i) costate[i] += pull[(k + 1) * MEASURED + i];
        memcpy(before, costate, sizeof before);
        for (int q = 3; q >= 0; --q) {
            for (int i = 0; i < SIZE; ++i) {
                back[i] = h * SHARE[q] / 6.0 * costate[i];
                if (q < 3) back[i] += h * ALONG[q + 1] * later[i];
            }
            memset(later, 0, sizeof later);
            pull_back(xi, stages + 4 * k + q, drive + (2 * k + HALF(q)) * ROWS, flight, theta, back, later, theta_back);
            for (int i = 0; i < SIZE; ++i) before[i] += later[i];
        }
        memcpy(costate, before, sizeof before);
    }
    for (int i = 0; i < MEASURED; ++i) costate[i] += pull[i];
    GRADIENTS
}
