/* Shooting intervals over lanes: RK4 step, cost, path rows, and their exact derivatives (paper eqs. 10-11).

   A lane is an interval, z = (x, u, h). Behind simd.h, rk4.h and layers.h, the functions f, df, ddf (dynamics), own, down
   and ddown (cost and path at the interval's start), with a network seen, dseen, ddseen, given, dgiven and ddgiven;
   the sizes NX, NU, NP, ROWS, D_ROWS (of the residual); the patterns A (d f/dx), B (d f/du), HESSIAN (Hessian of f),
   PATH (d path/d(x, u)), OWN (Hessian at the start), each as NAME_NNZ, NAME_ROW and NAME_COL. The dynamics do not
   depend on the states before FIRST: their columns of derivatives are those of the identity. NETWORK and RESIDUAL
   are 0 or 1. NETWORK_ROW is the first row of the dynamics that the network is added to, -1 for none. With a network
   SEEN, UNITS, LAST (widest layer) and the calls FORWARD, SLOPES and HESSIANS. */

#define NZ (NX + NU + 1)
#define NXU (NX + NU)
#define UPPER (NZ * (NZ + 1) / 2)
#define DRIVEN (NETWORK && NETWORK_ROW >= 0)

typedef struct { const V *x, *u, *h, *h0, *p; } Interval;

#if NETWORK
/* What the network sees is s; before: the Jacobian of every hidden unit's argument by s. d = given(state, out). */
typedef struct {
    V s[SEEN], a[UNITS + 1], out[3], d[3], before[UNITS * SEEN], slope[3 * SEEN], dseen[SEEN * 6], of_state[18],
        of_out[9], jacobian[18];
} Net;

INLINE void net_value(const double *xi, const V *state, Net *n) {
    seen(state, n->s);
    FORWARD
    given(state, n->out, n->d);
}

/* After net_value: the Jacobian of d by the state, (3, 6). */
static void net_slopes(const double *xi, const V *state, Net *n) {
    V wide[LAST * SEEN];
    SLOPES
    dseen(state, n->dseen);
    dgiven(state, n->out, n->of_state, n->of_out);
    for (int i = 0; i < 3; ++i) for (int q = 0; q < 6; ++q) {
        V total = n->of_state[i * 6 + q];
        for (int o = 0; o < 3; ++o) {
            V by = splat(0.0);
            for (int k = 0; k < SEEN; ++k) by += n->slope[o * SEEN + k] * n->dseen[k * 6 + q];
            total += n->of_out[i * 3 + o] * by;
        }
        n->jacobian[i * 6 + q] = total;
    }
}

/* inner += sum over units of weight_j before_j before_j', upper triangle; the weight has tanh's second derivative. */
INLINE void units_hessian(const V *a, const V *back, const V *before, int units, V *inner) {
    for (int j = 0; j < units; ++j) {
        V weight = -2.0 * a[j] * (1.0 - a[j] * a[j]) * back[j];
        for (int p = 0; p < SEEN; ++p) {
            V w = weight * before[j * SEEN + p];
            for (int q = p; q < SEEN; ++q) inner[p * SEEN + q] += w * before[j * SEEN + q];
        }
    }
}

/* After net_slopes: adds the Hessian of mu' d by the state to the upper triangle of total (6, 6). */
static void net_hessian(const double *xi, const V *state, const Net *n, const V *mu, V *total) {
    V out_mu[3], back[LAST], to[LAST], inner[SEEN * SEEN], hessian[36], cross[18], seen_hessian[36], by[18];
    for (int o = 0; o < 3; ++o)
        out_mu[o] = n->of_out[o] * mu[0] + n->of_out[3 + o] * mu[1] + n->of_out[6 + o] * mu[2];
    for (int k = 0; k < SEEN * SEEN; ++k) inner[k] = splat(0.0);
    HESSIANS
    ddgiven(state, n->out, mu, hessian, cross);
    ddseen(state, to, seen_hessian);
    for (int o = 0; o < 3; ++o) for (int q = 0; q < 6; ++q) {
        by[o * 6 + q] = splat(0.0);
        for (int k = 0; k < SEEN; ++k) by[o * 6 + q] += n->slope[o * SEEN + k] * n->dseen[k * 6 + q];
    }
    for (int p = 0; p < 6; ++p) {
        V half[SEEN];
        for (int k = 0; k < SEEN; ++k) {
            half[k] = splat(0.0);
            for (int m = 0; m < SEEN; ++m)
                half[k] += n->dseen[m * 6 + p] * (m <= k ? inner[m * SEEN + k] : inner[k * SEEN + m]);
        }
        for (int q = p; q < 6; ++q) {
            V sum = hessian[p * 6 + q] + seen_hessian[p * 6 + q];
            for (int k = 0; k < SEEN; ++k) sum += half[k] * n->dseen[k * 6 + q];
            for (int o = 0; o < 3; ++o) sum += cross[o * 6 + p] * by[o * 6 + q] + cross[o * 6 + q] * by[o * 6 + p];
            total[p * 6 + q] += sum;
        }
    }
}

#else
typedef struct { V d[3]; } Net;
#endif

/* One evaluation of the dynamics: where, the slope, what its derivatives need. S = d(x, u)/dz, K = d k/dz, both from
   the column FIRST on. */
typedef struct { V x[NX], k[NX], a[A_NNZ], b[B_NNZ], S[NXU * NZ], K[NX * NZ]; Net net; } Evaluation;

static void integrate(const double *xi, Interval at, int slopes, Evaluation *e) {
    V step = *at.h * *at.h0;
    for (int i = 0; i < 4; ++i) {
        Evaluation *now = e + i, *last = e + i - 1;
        rk4_at(NX, i, step, at.x, last->k, now->x);
        if (slopes) df(now->x, at.u, at.p, now->k, now->a, now->b);
        else f(now->x, at.u, at.p, now->k);
#if DRIVEN
        net_value(xi, now->x + 3, &now->net);
        if (slopes) net_slopes(xi, now->x + 3, &now->net);
        for (int r = 0; r < 3; ++r) now->k[NETWORK_ROW + r] += now->net.d[r];
#endif
        if (!slopes) continue;
        for (int r = 0; r < NX; ++r) {
            V *row = now->S + r * NZ;
            for (int c = FIRST; c < NZ; ++c) row[c] = i ? ALONG[i] * step * last->K[r * NZ + c] : splat(0.0);
            if (r >= FIRST) row[r] += 1.0;
            if (i) row[NXU] += ALONG[i] * *at.h0 * last->k[r];
        }
        for (int c = 0; c < NU * NZ; ++c) now->S[NX * NZ + c] = splat(0.0);
        for (int r = 0; r < NU; ++r) now->S[(NX + r) * NZ + NX + r] = splat(1.0);
        for (int c = 0; c < NX * NZ; ++c) now->K[c] = splat(0.0);
        for (int n = 0; n < A_NNZ; ++n) {
            V *row = now->K + A_ROW[n] * NZ;
            const V *of = now->S + A_COL[n] * NZ;
            for (int c = FIRST; c < NZ; ++c) row[c] += now->a[n] * of[c];
        }
#if DRIVEN
        for (int r = 0; r < 3; ++r) for (int q = 0; q < 6; ++q) {
            V *row = now->K + (NETWORK_ROW + r) * NZ;
            const V *of = now->S + (3 + q) * NZ;
            for (int c = FIRST; c < NZ; ++c) row[c] += now->net.jacobian[r * 6 + q] * of[c];
        }
#endif
        for (int n = 0; n < B_NNZ; ++n) now->K[B_ROW[n] * NZ + NX + B_COL[n]] += now->b[n];
    }
}

/* The network at the interval's start, for its part of the cost. */
INLINE const Net *start_net(const double *xi, Interval at, int slopes, const Evaluation *e, Net *own_net) {
#if NETWORK && RESIDUAL
#if DRIVEN
    if (e) return &e->net;
#endif
    net_value(xi, at.x + 3, own_net);
    if (slopes) net_slopes(xi, at.x + 3, own_net);
#endif
    return own_net;
}

static void value_of(const double *xi, Interval at, V *x_next, V *cost, V *path) {
    Evaluation e[4];
    V step = *at.h * *at.h0, d[D_ROWS], effort;
    integrate(xi, at, 0, e);
    for (int r = 0; r < NX; ++r) {
        V total = splat(0.0);
        for (int i = 0; i < 4; ++i) total += WEIGHT[i] * e[i].k[r];
        x_next[r] = at.x[r] + step * total;
    }
    own(at.x, at.u, at.p, &effort, d, path);
    Net net;
    const Net *n = start_net(xi, at, 0, e, &net);
    (void)n;
#if RESIDUAL
#if NETWORK
    for (int i = 0; i < 3; ++i) d[i] += n->d[i];
#endif
    for (int i = 0; i < D_ROWS; ++i) effort += d[i] * d[i];
#endif
    *cost = effort * step;
}

/* Running cost, its slope by (x, u), residual d and its slope (D_ROWS, NX), path slopes. */
typedef struct { V cost, slope[NXU], d[D_ROWS], jacobian[D_ROWS * NX], path[PATH_NNZ]; } Start;

INLINE void start_of(const double *xi, Interval at, const Evaluation *e, Start *s, Net *net) {
    down(at.x, at.u, at.p, &s->cost, s->slope, s->d, s->jacobian, s->path);
    const Net *n = start_net(xi, at, 1, e, net);
    (void)n;
#if RESIDUAL
#if NETWORK
    for (int i = 0; i < 3; ++i) {
        s->d[i] += n->d[i];
        for (int q = 0; q < 6; ++q) s->jacobian[i * NX + 3 + q] += n->jacobian[i * 6 + q];
    }
#endif
    for (int i = 0; i < D_ROWS; ++i) {
        s->cost += s->d[i] * s->d[i];
        for (int c = 0; c < NX; ++c) s->slope[c] += 2.0 * s->d[i] * s->jacobian[i * NX + c];
    }
#endif
}

/* d x_next/dz of the step. */
INLINE void step_slope(Interval at, const Evaluation *e, V *x_slope) {
    V step = *at.h * *at.h0;
    for (int r = 0; r < NX; ++r) {
        V *row = x_slope + r * NZ, mean = splat(0.0);
        for (int i = 0; i < 4; ++i) mean += WEIGHT[i] * e[i].k[r];
        for (int c = 0; c < FIRST; ++c) row[c] = splat(0.0);
        for (int c = FIRST; c < NZ; ++c) {
            V total = splat(0.0);
            for (int i = 0; i < 4; ++i) total += WEIGHT[i] * e[i].K[r * NZ + c];
            row[c] = step * total;
        }
        row[r] += 1.0;
        row[NXU] += *at.h0 * mean;
    }
}

INLINE void start_slopes(Interval at, const Start *s, V *cost_slope, V *path_slope) {
    V step = *at.h * *at.h0;
    for (int c = 0; c < NXU; ++c) cost_slope[c] = step * s->slope[c];
    cost_slope[NXU] = *at.h0 * s->cost;
    memcpy(path_slope, s->path, sizeof s->path);
}

static void slopes_of(const double *xi, Interval at, int dynamics, V *x_slope, V *cost_slope, V *path_slope) {
    Evaluation e[4];
    Start s;
    Net net;
    if (dynamics) {
        integrate(xi, at, 1, e);
        step_slope(at, e, x_slope);
    }
    start_of(xi, at, dynamics ? e : 0, &s, &net);
    start_slopes(at, &s, cost_slope, path_slope);
}

/* The slopes, and the upper triangle, row by row, of the Hessian in z of sigma cost + lam' x_next + path_lam' path. */
static void hessian_of(const double *xi, Interval at, const V *sigma, const V *lam, const V *path_lam, V *x_slope,
                       V *cost_slope, V *path_slope, V *upper) {
    Evaluation e[4];
    Start s;
    Net net;
    V step = *at.h * *at.h0, scale = *sigma * step, H[NZ * NZ];
    integrate(xi, at, 1, e);
    step_slope(at, e, x_slope);
    start_of(xi, at, e, &s, &net);
    start_slopes(at, &s, cost_slope, path_slope);
    for (int c = 0; c < NZ * NZ; ++c) H[c] = splat(0.0);

    V adjoint[4][NX], vjp[4][NX];
    for (int i = 3; i >= 0; --i) {
        for (int r = 0; r < NX; ++r) {
            adjoint[i][r] = WEIGHT[i] * step * lam[r];
            if (i < 3) adjoint[i][r] += ALONG[i + 1] * step * vjp[i + 1][r];
        }
        for (int r = 0; r < NX; ++r) vjp[i][r] = splat(0.0);
        for (int n = 0; n < A_NNZ; ++n) vjp[i][A_COL[n]] += e[i].a[n] * adjoint[i][A_ROW[n]];
#if DRIVEN
        for (int r = 0; r < 3; ++r)
            for (int q = 0; q < 6; ++q) vjp[i][3 + q] += e[i].net.jacobian[r * 6 + q] * adjoint[i][NETWORK_ROW + r];
#endif
    }
    for (int i = 0; i < 4; ++i) {
        V hessian[HESSIAN_NNZ], BS[NXU * NZ];
        ddf(e[i].x, at.u, at.p, adjoint[i], hessian);
#if DRIVEN
        V block[36];
        for (int c = 0; c < 36; ++c) block[c] = splat(0.0);
        net_hessian(xi, e[i].x + 3, &e[i].net, adjoint[i] + NETWORK_ROW, block);
        for (int n = 0; n < HESSIAN_NNZ; ++n) if (HESSIAN_BLOCK[n] >= 0) hessian[n] += block[HESSIAN_BLOCK[n]];
#endif
        for (int k = 0; k < ACTIVE; ++k) {
            V *row = BS + ACTIVE_ROW[k] * NZ;
            for (int c = FIRST; c < NZ; ++c) row[c] = splat(0.0);
        }
        for (int n = 0; n < HESSIAN_NNZ; ++n) {
            int r = HESSIAN_ROW[n], q = HESSIAN_COL[n];
            for (int c = FIRST; c < NZ; ++c) BS[r * NZ + c] += hessian[n] * e[i].S[q * NZ + c];
            if (r != q) for (int c = FIRST; c < NZ; ++c) BS[q * NZ + c] += hessian[n] * e[i].S[r * NZ + c];
        }
        for (int p = FIRST; p < NZ; ++p) {
            V *row = H + p * NZ;
            for (int k = 0; k < ACTIVE; ++k) {
                int r = ACTIVE_ROW[k];
                V by = e[i].S[r * NZ + p];
                for (int c = p; c < NZ; ++c) row[c] += by * BS[r * NZ + c];
            }
        }
    }
    for (int c = FIRST; c < NZ; ++c) {
        V cross = splat(0.0);
        for (int r = 0; r < NX; ++r) {
            for (int i = 0; i < 4; ++i) cross += WEIGHT[i] * lam[r] * e[i].K[r * NZ + c];
            for (int i = 1; i < 4; ++i) cross += ALONG[i] * vjp[i][r] * e[i - 1].K[r * NZ + c];
        }
        H[c * NZ + NXU] += (c == NXU ? 2.0 : 1.0) * *at.h0 * cross;
    }

    V block[OWN_NNZ], mu[D_ROWS];
    for (int i = 0; i < D_ROWS; ++i) mu[i] = 2.0 * scale * s.d[i];
    ddown(at.x, at.u, at.p, &scale, mu, path_lam, block);
    for (int n = 0; n < OWN_NNZ; ++n) H[OWN_ROW[n] * NZ + OWN_COL[n]] += block[n];
#if RESIDUAL
    for (int p = 0; p < NX; ++p) for (int q = p; q < NX; ++q)
        for (int i = 0; i < D_ROWS; ++i)
            H[p * NZ + q] += 2.0 * scale * s.jacobian[i * NX + p] * s.jacobian[i * NX + q];
#if NETWORK
    V hessian[36];
    for (int c = 0; c < 36; ++c) hessian[c] = splat(0.0);
    net_hessian(xi, at.x + 3, DRIVEN ? &e[0].net : &net, mu, hessian);
    for (int p = 0; p < 6; ++p) for (int q = p; q < 6; ++q) H[(3 + p) * NZ + 3 + q] += hessian[p * 6 + q];
#endif
#endif
    for (int c = 0; c < NXU; ++c) H[c * NZ + NXU] += *sigma * *at.h0 * s.slope[c];
    for (int p = 0, n = 0; p < NZ; ++p) for (int q = p; q < NZ; ++q, ++n) upper[n] = H[p * NZ + q];
}

/* Rows of a group of lanes in z: x, u, h, h0, p. */
INLINE Interval interval(const V *z) {
    return (Interval){z, z + NX, z + NXU, z + NZ, z + NZ + 1};
}
#define Z_ROWS (NZ + 1 + NP)

void values(const double *xi, long groups, const V *z, V *x_next, V *cost, V *path) {
    for (long g = 0; g < groups; ++g)
        value_of(xi, interval(z + g * Z_ROWS), x_next + g * NX, cost + g, path + g * ROWS);
}

void slopes(const double *xi, long groups, long dynamics, const V *z, V *x_slope, V *cost_slope, V *path_slope) {
    for (long g = 0; g < groups; ++g)
        slopes_of(xi, interval(z + g * Z_ROWS), (int)dynamics, x_slope + g * NX * NZ, cost_slope + g * NZ,
                  path_slope + g * PATH_NNZ);
}

void hessians(const double *xi, long groups, const V *z, const V *sigma, const V *lam, const V *path_lam, V *x_slope,
              V *cost_slope, V *path_slope, V *upper) {
    for (long g = 0; g < groups; ++g)
        hessian_of(xi, interval(z + g * Z_ROWS), sigma, lam + g * NX, path_lam + g * ROWS, x_slope + g * NX * NZ,
                   cost_slope + g * NZ, path_slope + g * PATH_NNZ, upper + g * UPPER);
}
