/* An interior point method for a chain of shooting intervals, with a Riccati recursion for its linear systems.

   Behind simd.h: the sizes NX, NU of the model, FREE (1: step sizes are unknowns), TIMED (1: so is the elapsed time)
   and ROWS of the kernel, PATH_NNZ, PATH_ROW, PATH_COL of its path slopes. Nothing is allocated here.

   A stage's unknowns are x (the model's states, the step size, the time), then u (the model's inputs, the step size
   of the next leg). The method is Ipopt's (Waechter and Biegler 2006): slacks s with r(w) - s = 0 for all bounded
   rows and unknowns, a barrier, exact Hessians, a filter. Equations between a stage's unknowns are met by a proximal
   method of multipliers with the fixed weight 1 / DELTA, so that a stage without freedom needs no pivoting. */

#define X (NX + FREE + TIMED)
#define U (NU + FREE)
#define W (X + U)
#define NZ (NX + NU + 1)
#define NXU (NX + NU)
#define UPPER (NZ * (NZ + 1) / 2)
#define COLUMNS (3 * LANES)
#define PAD ((W + COLUMNS - 1) / COLUMNS * COLUMNS) /* of a row of W numbers */
#define XR ((X + 3) / 4 * 4)
#define WR ((W + 3) / 4 * 4)
#define H_AT NX                                     /* the step size in x */
#define T_AT (NX + FREE)                            /* the time in x */

#define DELTA 1e-6            /* inverse weight of equations between a stage's unknowns */
#define PUSH 1e-3             /* least distance of a start from its bounds: of 1, the bound or the range */
#define BOUNDARY 0.99         /* share of the way to a bound that a step may take */
#define BARRIER_FALL 0.2      /* factors and power of the barrier parameter's decrease */
#define BARRIER_POWER 1.5
#define BARRIER_ERROR 1.0     /* error of a barrier problem, in units of its parameter, at which it is solved */
#define DAMPING_FIRST 1e-4    /* added to the Hessian's diagonal where it is not positive definite */
#define DAMPING_LEAST 1e-6
#define DAMPING_MOST 1e10
#define DAMPING_RAISED 0.1    /* up to here short steps raise it */
#define DAMPING_FACTOR 3.0
#define SHORT_STEP 0.3        /* shares of a step below and above which the damping changes */
#define LONG_STEP 0.95
#define LEAST_SHARE 1e-10
#define SLOPE_SHARE 1e-4      /* share of the predicted decrease that a step must bring */
#define FILTER_MARGIN 1e-5

/* Linearisation of a stage: x_next = ab (dx, du) + gap; the Hessian and slope of all that its unknowns cost. */
typedef struct { double ab[XR][PAD], hessian[WR][PAD], slope[PAD], gap[XR]; } Stage;
/* Riccati recursion: the cost to go dx' p dx / 2 + q' dx, and du = gain dx + shift. */
typedef struct { double p[XR][PAD], q[PAD], gain[U][PAD], shift[U]; } Ahead;

typedef void (*Values)(const double *, long, const V *, V *, V *, V *);
typedef void (*Hessians)(const double *, long, const V *, const V *, const V *, const V *, V *, V *, V *, V *);

enum { RUNNING, SOLVED, STUCK, NOT_FINITE };

typedef struct {
    long count, groups, parameters, places, filter_size;
    Values values;
    Hessians hessians;
    void (*places_of)(int second);       /* the rows of gates and shapes at `positions`; second: their Hessians too */
    const double *xi;                    /* the network's weights */
    /* over lanes: unknowns and parameters, results, multipliers */
    V *z, *x_next, *cost, *path, *x_slope, *cost_slope, *path_slope, *upper, *sigma, *lam, *path_lam;
    double *positions, *place_value, *place_slope, *place_hessian, *place_lam; /* by interval */
    const double *h0_s;
    const int *new_leg;                  /* by interval: its next stage begins a leg */
    /* Fixed and bounded quantities, stage by stage: an unknown's place, or W and a row's. begin: (count + 2). */
    const int *equal_begin, *equal_at, *bound_begin, *bound_at;
    const double *equal_to, *low, *high;
    double *w, *w_new, *dw, *costate, *costate_new; /* (count + 1, W or X) */
    double *equal_gap, *equal_y;
    double *row, *s, *s_new, *ds, *y, *y_new, *z_low, *z_high, *dz_low, *dz_high;
    Stage *stages;
    Ahead *ahead;
    double *filter;                      /* (filter_size, 2) */
    double tolerance, mu;                /* mu: barrier parameter */
    double damping, objective, barrier, violation, greatest, violation_most, violation_small;
    long filtered;
} Problem;

/* Writes the unknowns to the lanes. */
static void load(const Problem *p, const double *w) {
    for (long k = 0; k < p->groups * LANES; ++k) {
        const double *from = w + (k < p->count ? k : 0) * W;
        double *to = (double *)(p->z + k / LANES * (NZ + 1 + p->parameters)) + k % LANES;
        for (int i = 0; i < NX; ++i) to[i * LANES] = from[i];
        for (int i = 0; i < NU; ++i) to[(NX + i) * LANES] = from[X + i];
        to[NXU * LANES] = FREE ? from[H_AT] : 1.0;
    }
    if (p->places) {
        for (long k = 0; k < p->count; ++k) memcpy(p->positions + 3 * k, w + k * W, 3 * sizeof(double));
    }
}

INLINE double lane(const V *rows, long k, long height, long row) {
    return ((const double *)(rows + k / LANES * height + row))[k % LANES];
}

/* Value of a bounded or fixed quantity of a stage. */
INLINE double quantity(const Problem *p, const double *w, long k, int which) {
    if (which < W) return w[k * W + which];
    int row = which - W;
    return row < ROWS ? lane(p->path, k, ROWS, row) : p->place_value[k * p->places + row - ROWS];
}

/* Next states of interval k: the model's, the step size's and the time's. */
INLINE double next_state(const Problem *p, const double *w, long k, int i) {
    if (i < NX) return lane(p->x_next, k, NX, i);
#if FREE
    if (i == H_AT) return w[k * W + (p->new_leg[k] ? X + NU : H_AT)];
#endif
    return w[k * W + T_AT] + p->h0_s[k] * w[k * W + H_AT];
}

/* Evaluates at w, s: the objective, the barrier function, the sum and the greatest of the violations. */
static int evaluate(Problem *p, const double *w, const double *s, double *objective, double *barrier, double *sum,
                    double *greatest) {
    load(p, w);
    p->values(p->xi, p->groups, p->z, p->x_next, p->cost, p->path);
    if (p->places) p->places_of(0);
    double f = 0.0, total = 0.0, most = 0.0, log_sum = 0.0;
    for (long k = 0; k < p->count; ++k) {
        f += lane(p->cost, k, 1, 0);
        for (int i = 0; i < X; ++i) {
            double gap = fabs(next_state(p, w, k, i) - w[(k + 1) * W + i]);
            total += gap;
            most = gap > most ? gap : most;
        }
    }
    for (long k = 0; k <= p->count; ++k) {
        for (int e = p->equal_begin[k]; e < p->equal_begin[k + 1]; ++e) {
            double gap = fabs(quantity(p, w, k, p->equal_at[e]) - p->equal_to[e]);
            total += gap;
            most = gap > most ? gap : most;
        }
        for (int b = p->bound_begin[k]; b < p->bound_begin[k + 1]; ++b) {
            p->row[b] = quantity(p, w, k, p->bound_at[b]);
            double gap = fabs(p->row[b] - s[b]), below = s[b] - p->low[b], above = p->high[b] - s[b];
            total += gap;
            most = gap > most ? gap : most;
            if (below < INFINITY) log_sum += log(below);
            if (above < INFINITY) log_sum += log(above);
        }
    }
    *objective = f;
    *barrier = *objective - p->mu * log_sum;
    *sum = total;
    *greatest = most;
    return isfinite(*barrier) && isfinite(total);
}

/* out (PAD) += by in. */
INLINE void add_row(double *out, double by, const double *in) {
    for (int j = 0; j < PAD; j += LANES) {
        V sum, row;
        memcpy(&sum, out + j, sizeof sum);
        memcpy(&row, in + j, sizeof row);
        sum += by * row;
        memcpy(out + j, &sum, sizeof sum);
    }
}

/* row (PAD) *= by. */
INLINE void scale_row(double *row, double by) {
    for (int j = 0; j < PAD; j += LANES) {
        V value;
        memcpy(&value, row + j, sizeof value);
        value *= by;
        memcpy(row + j, &value, sizeof value);
    }
}

/* Adds weight times the slope of a quantity to `out` (W). */
INLINE void add_slope(const Problem *p, long k, int which, double weight, double *out) {
    if (which < W) { out[which] += weight; return; }
    int row = which - W;
    if (row < ROWS) {
        for (int n = 0; n < PATH_NNZ; ++n) if (PATH_ROW[n] == row) {
            int c = PATH_COL[n];
            out[c < NX ? c : X + c - NX] += weight * lane(p->path_slope, k, PATH_NNZ, n);
        }
    } else {
        const double *slope = p->place_slope + (k * p->places + row - ROWS) * 3;
        for (int i = 0; i < 3; ++i) out[i] += weight * slope[i];
    }
}

/* Computes slopes and Hessians at w: gaps, ab, the Lagrangian's Hessian and the objective's slope. */
static void differentiate(Problem *p) {
    const double *w = p->w;
    for (long k = 0; k < p->groups * LANES; ++k) {
        long from = k < p->count ? k : 0;
        double *lam = (double *)(p->lam + k / LANES * NX) + k % LANES;
        double *path_lam = (double *)(p->path_lam + k / LANES * ROWS) + k % LANES;
        for (int i = 0; i < NX; ++i) lam[i * LANES] = p->costate[(from + 1) * X + i];
        for (int i = 0; i < ROWS; ++i) path_lam[i * LANES] = 0.0;
        if (p->places) memset(p->place_lam + from * p->places, 0, sizeof(double) * p->places);
        for (int e = p->equal_begin[from]; e < p->equal_begin[from + 1]; ++e) {
            int row = p->equal_at[e] - W;
            if (row >= ROWS) p->place_lam[from * p->places + row - ROWS] = p->equal_y[e];
            else if (row >= 0) path_lam[row * LANES] = p->equal_y[e];
        }
        for (int b = p->bound_begin[from]; b < p->bound_begin[from + 1]; ++b) {
            int row = p->bound_at[b] - W;
            if (row >= ROWS) p->place_lam[from * p->places + row - ROWS] = p->y[b];
            else if (row >= 0) path_lam[row * LANES] = p->y[b];
        }
    }
    p->hessians(p->xi, p->groups, p->z, p->sigma, p->lam, p->path_lam, p->x_slope, p->cost_slope, p->path_slope,
                p->upper);
    if (p->places) p->places_of(1);
    for (long k = 0; k < p->count; ++k) {
        Stage *t = p->stages + k;
        for (int i = 0; i < X; ++i) t->gap[i] = next_state(p, w, k, i) - w[(k + 1) * W + i];
        for (int i = 0; i < NX; ++i) {
            for (int c = 0; c < NX; ++c) t->ab[i][c] = lane(p->x_slope, k, NX * NZ, i * NZ + c);
            for (int c = 0; c < NU; ++c) t->ab[i][X + c] = lane(p->x_slope, k, NX * NZ, i * NZ + NX + c);
            if (FREE) t->ab[i][H_AT] = lane(p->x_slope, k, NX * NZ, i * NZ + NXU);
        }
#if FREE
        t->ab[H_AT][p->new_leg[k] ? X + NU : H_AT] = 1.0;
#endif
#if TIMED
        t->ab[T_AT][T_AT] = 1.0;
        t->ab[T_AT][H_AT] = p->h0_s[k];
#endif
        for (int i = 0; i < NX; ++i) t->slope[i] = lane(p->cost_slope, k, NZ, i);
        for (int i = 0; i < NU; ++i) t->slope[X + i] = lane(p->cost_slope, k, NZ, NX + i);
        if (FREE) t->slope[H_AT] = lane(p->cost_slope, k, NZ, NXU);
        if (FREE) t->slope[X + NU] = 0.0;
        if (TIMED) t->slope[T_AT] = 0.0;
        for (int i = 0, n = 0; i < NZ; ++i) for (int j = i; j < NZ; ++j, ++n) {
            if (!FREE && j == NXU) continue;
            int r = i < NX ? i : i < NXU ? X + i - NX : H_AT, c = j < NX ? j : j < NXU ? X + j - NX : H_AT;
            t->hessian[r][c] = t->hessian[c][r] = lane(p->upper, k, UPPER, n);
        }
#if FREE
        for (int c = 0; c < W; ++c) t->hessian[X + NU][c] = t->hessian[c][X + NU] = 0.0;
        t->hessian[X + NU][X + NU] = p->new_leg[k] ? 0.0 : 1.0;
#endif
        if (p->places) for (int i = 0; i < 3; ++i) for (int j = 0; j < 3; ++j)
            t->hessian[i][j] += p->place_hessian[k * 9 + 3 * i + j];
    }
}

/* Dual infeasibility and complementarity for barrier parameter mu, scaled as Ipopt scales them. */
static double optimality(const Problem *p, double mu) {
    double dual = 0.0, compl = 0.0, sum = 0.0;
    long number = 0;
    double slope[PAD];
    for (long k = 0; k <= p->count; ++k) {
        int width = k < p->count ? W : X;
        memset(slope, 0, sizeof slope);
        if (k < p->count) {
            const Stage *t = p->stages + k;
            memcpy(slope, t->slope, sizeof(double) * W);
            for (int i = 0; i < X; ++i) {
                add_row(slope, p->costate[(k + 1) * X + i], t->ab[i]);
            }
        }
        if (k) for (int i = 0; i < X; ++i) {
            slope[i] -= p->costate[k * X + i];
            sum += fabs(p->costate[k * X + i]);
            ++number;
        }
        for (int e = p->equal_begin[k]; e < p->equal_begin[k + 1]; ++e) {
            add_slope(p, k, p->equal_at[e], p->equal_y[e], slope);
            sum += fabs(p->equal_y[e]);
            ++number;
        }
        for (int b = p->bound_begin[k]; b < p->bound_begin[k + 1]; ++b) {
            add_slope(p, k, p->bound_at[b], p->y[b], slope);
            double below = p->s[b] - p->low[b], above = p->high[b] - p->s[b], rest = -p->y[b];
            if (below < INFINITY) {
                rest -= p->z_low[b];
                compl = fmax(compl, fabs(below * p->z_low[b] - mu));
                sum += p->z_low[b];
            }
            if (above < INFINITY) {
                rest += p->z_high[b];
                compl = fmax(compl, fabs(above * p->z_high[b] - mu));
                sum += p->z_high[b];
            }
            dual = fmax(dual, fabs(rest));
            ++number;
        }
        for (int c = 0; c < width; ++c) dual = fmax(dual, fabs(slope[c]));
    }
    double scale = fmax(100.0, number ? sum / (double)number : 0.0) / 100.0;
    return fmax(fmax(dual / scale, compl / scale), p->greatest);
}

/* out (4, PAD) += a (4, inner) b (inner, PAD); a's entry r, l is at r a_row + l a_column. */
INLINE void add_product(const double *a, long a_row, long a_column, const double *b, int inner, double *out) {
    for (int j = 0; j < PAD; j += COLUMNS) {
        V s[4][3];
        for (int r = 0; r < 4; ++r) memcpy(s[r], out + r * PAD + j, sizeof s[r]);
        for (int l = 0; l < inner; ++l) {
            V t[3];
            memcpy(t, b + l * PAD + j, sizeof t);
            for (int r = 0; r < 4; ++r) {
                V by = splat(a[r * a_row + l * a_column]);
                s[r][0] += by * t[0]; s[r][1] += by * t[1]; s[r][2] += by * t[2];
            }
        }
        for (int r = 0; r < 4; ++r) memcpy(out + r * PAD + j, s[r], sizeof s[r]);
    }
}

/* Lower factor of a symmetric matrix in place; 0 where it is not positive definite. */
INLINE int factorise(double *a, int size, int stride) {
    for (int j = 0; j < size; ++j) {
        double d = a[j * stride + j];
        for (int l = 0; l < j; ++l) d -= a[j * stride + l] * a[j * stride + l];
        if (!(d > 1e-14)) return 0;
        d = sqrt(d);
        a[j * stride + j] = d;
        for (int i = j + 1; i < size; ++i) {
            double v = a[i * stride + j];
            for (int l = 0; l < j; ++l) v -= a[i * stride + l] * a[j * stride + l];
            a[i * stride + j] = v / d;
        }
    }
    return 1;
}

/* b (size, PAD) := inverse of factor factor' times b. */
INLINE void substitute(const double *a, int size, int stride, double *b) {
    for (int i = 0; i < size; ++i) {
        for (int l = 0; l < i; ++l) add_row(b + i * PAD, -a[i * stride + l], b + l * PAD);
        scale_row(b + i * PAD, 1.0 / a[i * stride + i]);
    }
    for (int i = size; i-- > 0;) {
        for (int l = i + 1; l < size; ++l) add_row(b + i * PAD, -a[l * stride + i], b + l * PAD);
        scale_row(b + i * PAD, 1.0 / a[i * stride + i]);
    }
}

/* Adds what fixed and bounded quantities of stage k cost to a Hessian and a slope. */
static void add_barrier(const Problem *p, long k, double (*hessian)[PAD], double *slope) {
    for (int e = p->equal_begin[k]; e < p->equal_begin[k + 1]; ++e) {
        int which = p->equal_at[e];
        double gap = quantity(p, p->w, k, which) - p->equal_to[e], by = p->equal_y[e] + gap / DELTA;
        double one[PAD] = {0.0};
        if (which < W) { hessian[which][which] += 1.0 / DELTA; slope[which] += by; continue; }
        add_slope(p, k, which, 1.0, one);
        add_row(slope, by, one);
        for (int i = 0; i < W; ++i) if (one[i] != 0.0) add_row(hessian[i], one[i] / DELTA, one);
    }
    for (int b = p->bound_begin[k]; b < p->bound_begin[k + 1]; ++b) {
        int which = p->bound_at[b];
        double below = p->s[b] - p->low[b], above = p->high[b] - p->s[b], weight = 0.0, push = 0.0;
        if (below < INFINITY) { weight += p->z_low[b] / below; push -= p->mu / below; }
        if (above < INFINITY) { weight += p->z_high[b] / above; push += p->mu / above; }
        push += weight * (p->row[b] - p->s[b]);
        if (which < W) { hessian[which][which] += weight; slope[which] += push; continue; }
        double one[PAD] = {0.0};
        add_slope(p, k, which, 1.0, one);
        add_row(slope, push, one);
        for (int i = 0; i < W; ++i) if (one[i] != 0.0) add_row(hessian[i], weight * one[i], one);
    }
}

/* The Riccati recursion; 0 where the Hessian on the linearised chain is not positive definite. */
static int recurse(Problem *p) {
    double m[WR][PAD], slope[PAD], t[XR][PAD], solved[U][PAD];
    for (long k = p->count; k >= 0; --k) {
        Ahead *here = p->ahead + k, *next = here + 1;
        if (k == p->count) {
            memset(m, 0, sizeof m);
            memset(slope, 0, sizeof slope);
        } else {
            memcpy(m, p->stages[k].hessian, sizeof m);
            memcpy(slope, p->stages[k].slope, sizeof slope);
        }
        for (int i = 0; i < W; ++i) m[i][i] += p->damping;
        add_barrier(p, k, m, slope);
        if (k < p->count) {
            const Stage *stage = p->stages + k;
            double ahead[PAD];
            memcpy(ahead, next->q, sizeof ahead);
            for (int j = 0; j < X; ++j) add_row(ahead, stage->gap[j], next->p[j]);
            for (int i = 0; i < X; ++i) add_row(slope, ahead[i], stage->ab[i]);
            memset(t, 0, sizeof t);
            for (int i = 0; i < XR; i += 4) add_product(next->p[i], PAD, 1, stage->ab[0], X, t[i]);
            for (int i = 0; i < WR; i += 4) add_product(stage->ab[0] + i, 1, PAD, t[0], X, m[i]);
            double factor[U][U];
            for (int i = 0; i < U; ++i) {
                for (int j = 0; j < U; ++j) factor[i][j] = m[X + i][X + j];
                memcpy(solved[i], m[X + i], sizeof solved[i]);
                solved[i][X] = slope[X + i];
            }
            if (!factorise(factor[0], U, U)) return 0;
            substitute(factor[0], U, U, solved[0]);
            for (int i = 0; i < U; ++i) {
                for (int j = 0; j < X; ++j) here->gain[i][j] = -solved[i][j];
                here->shift[i] = -solved[i][X];
                for (int j = 0; j < X; ++j) add_row(m[j], m[X + i][j], here->gain[i]);
                add_row(slope, here->shift[i], m[X + i]);
            }
        }
        for (int i = 0; i < X; ++i) {
            for (int j = 0; j < i; ++j) here->p[i][j] = here->p[j][i] = 0.5 * (m[i][j] + m[j][i]);
            here->p[i][i] = m[i][i];
            here->q[i] = slope[i];
        }
    }
    double first[XR][PAD], dx[X][PAD];
    memcpy(first, p->ahead[0].p, sizeof first);
    if (!factorise(first[0], X, PAD)) return 0;
    memset(dx, 0, sizeof dx);
    for (int i = 0; i < X; ++i) dx[i][0] = -p->ahead[0].q[i];
    substitute(first[0], X, PAD, dx[0]);
    for (int i = 0; i < X; ++i) p->dw[i] = dx[i][0];
    return 1;
}

/* The step in all unknowns and multipliers from the recursion's gains. */
static void roll(Problem *p) {
    for (long k = 0; k <= p->count; ++k) {
        double *dx = p->dw + k * W, *du = dx + X;
        const Ahead *a = p->ahead + k;
        if (k) {
            double costate[PAD];
            memcpy(costate, a->q, sizeof costate);
            for (int j = 0; j < X; ++j) add_row(costate, dx[j], a->p[j]);
            memcpy(p->costate_new + k * X, costate, sizeof(double) * X);
        }
        if (k == p->count) break;
        const Stage *t = p->stages + k;
        double *next = p->dw + (k + 1) * W;
        for (int i = 0; i < U; ++i) {
            du[i] = a->shift[i];
            for (int j = 0; j < X; ++j) du[i] += a->gain[i][j] * dx[j];
        }
        for (int i = 0; i < X; ++i) {
            next[i] = t->gap[i];
            for (int c = 0; c < W; ++c) next[i] += t->ab[i][c] * dx[c];
        }
    }
}

INLINE double slope_along(const Problem *p, long k, int which) {
    const double *dw = p->dw + k * W;
    if (which < W) return dw[which];
    double one[PAD] = {0.0}, total = 0.0;
    add_slope(p, k, which, 1.0, one);
    for (int i = 0; i < W; ++i) total += one[i] * dw[i];
    return total;
}

/* Steps of slacks and multipliers, the greatest shares of both steps, and the barrier function's slope along. */
static double complete(Problem *p, double *primal, double *dual) {
    double tau = fmax(BOUNDARY, 1.0 - p->mu), along = 0.0;
    *primal = *dual = 1.0;
    for (long k = 0; k < p->count; ++k)
        for (int c = 0; c < W; ++c) along += p->stages[k].slope[c] * p->dw[k * W + c];
    for (long k = 0; k <= p->count; ++k) for (int b = p->bound_begin[k]; b < p->bound_begin[k + 1]; ++b) {
        double below = p->s[b] - p->low[b], above = p->high[b] - p->s[b], push = 0.0, weight = 0.0;
        double ds = p->ds[b] = slope_along(p, k, p->bound_at[b]) + p->row[b] - p->s[b];
        if (below < INFINITY) {
            push -= p->mu / below;
            weight += p->z_low[b] / below;
            p->dz_low[b] = p->mu / below - p->z_low[b] - p->z_low[b] / below * ds;
            if (ds < 0.0) *primal = fmin(*primal, -tau * below / ds);
            if (p->dz_low[b] < 0.0) *dual = fmin(*dual, -tau * p->z_low[b] / p->dz_low[b]);
        }
        if (above < INFINITY) {
            push += p->mu / above;
            weight += p->z_high[b] / above;
            p->dz_high[b] = p->mu / above - p->z_high[b] + p->z_high[b] / above * ds;
            if (ds > 0.0) *primal = fmin(*primal, tau * above / ds);
            if (p->dz_high[b] < 0.0) *dual = fmin(*dual, -tau * p->z_high[b] / p->dz_high[b]);
        }
        p->y_new[b] = push + weight * ds;
        along += push * ds;
    }
    return along;
}

static int filtered_out(const Problem *p, double violation, double barrier) {
    for (long n = 0; n < p->filtered; ++n)
        if (violation >= p->filter[2 * n] && barrier >= p->filter[2 * n + 1]) return 1;
    return 0;
}

static void augment(Problem *p) {
    long n = p->filtered < p->filter_size ? p->filtered++ : p->filter_size - 1;
    p->filter[2 * n] = (1.0 - FILTER_MARGIN) * p->violation;
    p->filter[2 * n + 1] = p->barrier - FILTER_MARGIN * p->violation;
}

static void accept(Problem *p, double share, double dual_share) {
    for (long k = 1; k <= p->count; ++k) for (int i = 0; i < X; ++i)
        p->costate[k * X + i] += share * (p->costate_new[k * X + i] - p->costate[k * X + i]);
    for (long k = 0; k <= p->count; ++k) {
        for (int e = p->equal_begin[k]; e < p->equal_begin[k + 1]; ++e)
            p->equal_y[e] += share * (p->equal_gap[e] + slope_along(p, k, p->equal_at[e])) / DELTA;
        for (int b = p->bound_begin[k]; b < p->bound_begin[k + 1]; ++b) {
            p->y[b] += share * (p->y_new[b] - p->y[b]);
            double below = p->s_new[b] - p->low[b], above = p->high[b] - p->s_new[b];
            if (below < INFINITY) {
                double z = p->z_low[b] + dual_share * p->dz_low[b];
                p->z_low[b] = fmax(fmin(z, 1e10 * p->mu / below), p->mu / (1e10 * below));
            }
            if (above < INFINITY) {
                double z = p->z_high[b] + dual_share * p->dz_high[b];
                p->z_high[b] = fmax(fmin(z, 1e10 * p->mu / above), p->mu / (1e10 * above));
            }
        }
    }
    double *w = p->w, *s = p->s;
    p->w = p->w_new; p->w_new = w;
    p->s = p->s_new; p->s_new = s;
}

static void store_gaps(Problem *p) {
    for (long k = 0; k <= p->count; ++k) for (int e = p->equal_begin[k]; e < p->equal_begin[k + 1]; ++e)
        p->equal_gap[e] = quantity(p, p->w, k, p->equal_at[e]) - p->equal_to[e];
}

/* The filter line search along the step; 0 where no share is acceptable. */
static double search(Problem *p) {
    double primal, dual, along = complete(p, &primal, &dual);
    for (double share = primal; share > LEAST_SHARE; share *= 0.5) {
        for (long i = 0; i < (p->count + 1) * W; ++i) p->w_new[i] = p->w[i] + share * p->dw[i];
        for (int b = 0; b < p->bound_begin[p->count + 1]; ++b) p->s_new[b] = p->s[b] + share * p->ds[b];
        double objective, barrier, sum, greatest;
        int finite = evaluate(p, p->w_new, p->s_new, &objective, &barrier, &sum, &greatest);
        if (!finite || sum > p->violation_most || filtered_out(p, sum, barrier)) continue;
        int descent = along < 0.0 && share * pow(-along, 2.3) > pow(p->violation, 1.1);
        double rounding = 10.0 * 2.2e-16 * fabs(p->barrier);
        int armijo = barrier - p->barrier - rounding <= SLOPE_SHARE * share * along;
        if (p->violation <= p->violation_small && descent) {
            if (!armijo) continue;
        } else if (sum > (1.0 - FILTER_MARGIN) * p->violation && barrier - rounding > p->barrier - FILTER_MARGIN * p->violation) {
            continue;
        }
        if (!(descent && armijo)) augment(p);
        accept(p, share, dual);
        p->objective = objective;
        p->barrier = barrier;
        p->violation = sum;
        p->greatest = greatest;
        return share;
    }
    return 0.0;
}

/* Sets the barrier parameter: the barrier function changes, and the filter is emptied. */
static void set_barrier(Problem *p, double mu) {
    double log_sum = (p->objective - p->barrier) / p->mu;
    p->mu = mu;
    p->barrier = p->objective - mu * log_sum;
    p->filtered = 0;
}

/* Slacks near the rows but inside their bounds; multipliers as given, or of a point on the central path. */
static void place_slacks(Problem *p) {
    load(p, p->w);
    p->values(p->xi, p->groups, p->z, p->x_next, p->cost, p->path);
    if (p->places) p->places_of(0);
    for (long k = 0; k <= p->count; ++k) for (int b = p->bound_begin[k]; b < p->bound_begin[k + 1]; ++b) {
        double low = p->low[b], high = p->high[b], width = high - low, s = quantity(p, p->w, k, p->bound_at[b]);
        if (low > -INFINITY) s = fmax(s, low + PUSH * fmin(fmax(1.0, fabs(low)), width));
        if (high < INFINITY) s = fmin(s, high - PUSH * fmin(fmax(1.0, fabs(high)), width));
        p->s[b] = s;
        p->z_low[b] = low > -INFINITY ? fmax(p->mu / (s - low), -p->y[b]) : 0.0;
        p->z_high[b] = high < INFINITY ? fmax(p->mu / (high - s), p->y[b]) : 0.0;
        p->y[b] = p->z_high[b] - p->z_low[b];
    }
}

/* Evaluates the start, where w, the costates and the multipliers of equations and bounds are set. */
int begin(Problem *p) {
    p->filtered = 0;
    p->damping = 0.0;
    *p->sigma = splat(1.0);
    place_slacks(p);
    if (!evaluate(p, p->w, p->s, &p->objective, &p->barrier, &p->violation, &p->greatest)) return NOT_FINITE;
    p->violation_most = 1e4 * fmax(1.0, p->violation);
    p->violation_small = 1e-4 * fmax(1.0, p->violation);
    differentiate(p);
    store_gaps(p);
    return RUNNING;
}

/* One iteration. The damping follows the steps: near-singular Hessians give long ones that bounds cut short. */
int iterate(Problem *p) {
    double least = 0.1 * p->tolerance, error = optimality(p, 0.0);
    if (!isfinite(error)) return NOT_FINITE;
    if (error <= p->tolerance) return SOLVED;
    while (p->mu > least && optimality(p, p->mu) <= BARRIER_ERROR * p->mu)
        set_barrier(p, fmax(least, fmin(BARRIER_FALL * p->mu, pow(p->mu, BARRIER_POWER))));
    for (; p->damping <= DAMPING_MOST; p->damping = fmax(DAMPING_FIRST, DAMPING_FACTOR * p->damping)) {
        if (!recurse(p)) continue;
        roll(p);
        double share = search(p);
        if (share > 0.0) {
            if (share > LONG_STEP) p->damping /= DAMPING_FACTOR;
            else if (share < SHORT_STEP && p->damping < DAMPING_RAISED) p->damping *= DAMPING_FACTOR;
            if (p->damping < DAMPING_LEAST) p->damping = 0.0;
            differentiate(p);
            store_gaps(p);
            return RUNNING;
        }
        double objective, barrier, sum, greatest; /* the values are those of a rejected point */
        evaluate(p, p->w, p->s, &objective, &barrier, &sum, &greatest);
    }
    p->damping = 0.0;
    return STUCK;
}

long stage_bytes(void) { return sizeof(Stage); }
long ahead_bytes(void) { return sizeof(Ahead); }
long unknowns(void) { return W; }
long states(void) { return X; }
