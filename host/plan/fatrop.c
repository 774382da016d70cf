/* A chain of stages for Fatrop, out of flat arrays that the caller fills: the unknowns w, node by node states then
   inputs; objective, its slope, constraint rows, the nonzeros of their Jacobian and of the Lagrangian's Hessian.

   Rows are gaps x_{k+1} - F(x_k, u_k), equalities and inequalities; bounds of unknowns are inequalities too. Fatrop's
   own order within a stage is inputs, then states; its matrices are transposed, with the value in the last row. */

#include <signal.h>
#include <string.h>
#include <unistd.h>
#include <blasfeo.h>
#include <fatrop/ocp/OCPCInterface.h>

/* Entries of stages' matrices: value = sign source[from]; a negative `from` means 1. */
typedef struct { long count; const int *stage, *row, *column, *from; } Entries;

typedef struct {
    int stages;
    const int *nx, *nu, *equalities, *inequalities, *start; /* start: of each stage in w */
    const double *initial, *lower, *upper;                  /* in w's order; of inequalities, stage by stage */
    double *w, *objective, *gradient, *rows, *jacobian, *hessian, *lam, *sigma;
    void (*fill)(int);         /* one of the parts below, at w */
    const int *gap_row;        /* of each stage but the last */
    const int *equal_row, *bounded_row, *bounded_w; /* stage by stage; a row or, where that is -1, an unknown */
    const double *equal_to;
    Entries dynamics, equal, bounded, hessian_entries;
} Chain;

enum { OBJECTIVE, GRADIENT, ROWS, JACOBIAN, HESSIAN };

static void read_unknowns(const Chain *c, const double *primal) {
    for (int k = 0; k < c->stages; ++k) {
        int at = c->start[k];
        memcpy(c->w + at, primal + at + c->nu[k], sizeof(double) * c->nx[k]);
        memcpy(c->w + at + c->nx[k], primal + at, sizeof(double) * c->nu[k]);
    }
}

static void clear(struct blasfeo_dmat *m, int rows, int columns) {
    for (int i = 0; i < rows; ++i) for (int j = 0; j < columns; ++j) BLASFEO_DMATEL(m, i, j) = 0.0;
}

static void put(Entries e, double sign, const double *source, struct blasfeo_dmat *matrices) {
    for (long n = 0; n < e.count; ++n) {
        struct blasfeo_dmat *m = matrices + e.stage[n];
        BLASFEO_DMATEL(m, e.row[n], e.column[n]) = e.from[n] < 0 ? 1.0 : sign * source[e.from[n]];
    }
}

static int dim_nx(int k, void *c) { return ((Chain *)c)->nx[k]; }
static int dim_nu(int k, void *c) { return ((Chain *)c)->nu[k]; }
static int dim_equal(int k, void *c) { return ((Chain *)c)->equalities[k]; }
static int dim_bounded(int k, void *c) { return ((Chain *)c)->inequalities[k]; }
static int dim_stages(void *c) { return ((Chain *)c)->stages; }
static int no_dim(int k, void *c) { (void)k; (void)c; return 0; }
static int no_dims(void *c) { (void)c; return 0; }
static int no_values(double *v, int k, void *c) { (void)v; (void)k; (void)c; return 0; }
static int no_globals(double *v, void *c) { (void)v; (void)c; return 0; }

static int initial_x(double *x, int k, void *user) {
    const Chain *c = user;
    memcpy(x, c->initial + c->start[k], sizeof(double) * c->nx[k]);
    return 0;
}

static int initial_u(double *u, int k, void *user) {
    const Chain *c = user;
    memcpy(u, c->initial + c->start[k] + c->nx[k], sizeof(double) * c->nu[k]);
    return 0;
}

static int bounds(double *lower, double *upper, int k, void *user) {
    const Chain *c = user;
    int at = 0;
    for (int i = 0; i < k; ++i) at += c->inequalities[i];
    memcpy(lower, c->lower + at, sizeof(double) * c->inequalities[k]);
    memcpy(upper, c->upper + at, sizeof(double) * c->inequalities[k]);
    return 0;
}

/* Of inequality n, counted over all stages. */
static double bounded_value(const Chain *c, int n) {
    return c->bounded_row[n] < 0 ? c->w[c->bounded_w[n]] : c->rows[c->bounded_row[n]];
}

static int constraint_slopes(const double *primal, const double *stage, const double *global,
                             struct blasfeo_dmat *babt, struct blasfeo_dmat *ggt, struct blasfeo_dmat *ggt_ineq,
                             const struct FatropOcpCDims *s, void *user) {
    const Chain *c = user;
    (void)stage; (void)global; (void)s;
    read_unknowns(c, primal);
    c->fill(JACOBIAN);
    for (int k = 0, e = 0, b = 0; k < c->stages; ++k) {
        int high = c->nx[k] + c->nu[k];
        if (k + 1 < c->stages) {
            clear(babt + k, high, c->nx[k + 1]);
            for (int j = 0; j < c->nx[k + 1]; ++j) BLASFEO_DMATEL(babt + k, high, j) = -c->rows[c->gap_row[k] + j];
        }
        clear(ggt + k, high, c->equalities[k]);
        clear(ggt_ineq + k, high, c->inequalities[k]);
        for (int j = 0; j < c->equalities[k]; ++j, ++e)
            BLASFEO_DMATEL(ggt + k, high, j) = c->rows[c->equal_row[e]] - c->equal_to[e];
        for (int j = 0; j < c->inequalities[k]; ++j, ++b) BLASFEO_DMATEL(ggt_ineq + k, high, j) = bounded_value(c, b);
    }
    put(c->dynamics, -1.0, c->jacobian, babt);
    put(c->equal, 1.0, c->jacobian, ggt);
    put(c->bounded, 1.0, c->jacobian, ggt_ineq);
    return 1;
}

static int constraint_values(const double *primal, const double *stage, const double *global, double *res,
                             const struct FatropOcpCDims *s, void *user) {
    const Chain *c = user;
    (void)stage; (void)global;
    read_unknowns(c, primal);
    c->fill(ROWS);
    for (int k = 0, e = 0, b = 0; k < c->stages; ++k) {
        for (int j = 0; j < c->equalities[k]; ++j, ++e)
            res[s->g_offs[k] + j] = c->rows[c->equal_row[e]] - c->equal_to[e];
        for (int j = 0; j < c->inequalities[k]; ++j, ++b) res[s->g_ineq_offs[k] + j] = bounded_value(c, b);
        if (k + 1 < c->stages)
            for (int j = 0; j < c->nx[k + 1]; ++j) res[s->dyn_eq_offs[k] + j] = -c->rows[c->gap_row[k] + j];
    }
    return 1;
}

static int objective_slope(double scale, const double *primal, const double *stage, const double *global,
                           double *res, const struct FatropOcpCDims *s, void *user) {
    const Chain *c = user;
    (void)stage; (void)global; (void)s;
    read_unknowns(c, primal);
    c->fill(GRADIENT);
    for (int k = 0; k < c->stages; ++k) {
        int at = c->start[k];
        for (int i = 0; i < c->nx[k]; ++i) res[at + c->nu[k] + i] = scale * c->gradient[at + i];
        for (int i = 0; i < c->nu[k]; ++i) res[at + i] = scale * c->gradient[at + c->nx[k] + i];
    }
    return 1;
}

static int objective_value(double scale, const double *primal, const double *stage, const double *global, double *res,
                           const struct FatropOcpCDims *s, void *user) {
    const Chain *c = user;
    (void)stage; (void)global; (void)s;
    read_unknowns(c, primal);
    c->fill(OBJECTIVE);
    *res = scale * *c->objective;
    return 1;
}

static int lagrangian_hessian(double scale, const double *primal, const double *lam, const double *stage,
                           const double *global, struct blasfeo_dmat *res, const struct FatropOcpCDims *s, void *user) {
    const Chain *c = user;
    (void)stage; (void)global;
    read_unknowns(c, primal);
    *c->sigma = scale;
    for (int k = 0, e = 0, b = 0; k < c->stages; ++k) {
        for (int j = 0; j < c->equalities[k]; ++j, ++e) c->lam[c->equal_row[e]] = lam[s->g_offs[k] + j];
        for (int j = 0; j < c->inequalities[k]; ++j, ++b)
            if (c->bounded_row[b] >= 0) c->lam[c->bounded_row[b]] = lam[s->g_ineq_offs[k] + j];
        if (k + 1 < c->stages)
            for (int j = 0; j < c->nx[k + 1]; ++j) c->lam[c->gap_row[k] + j] = -lam[s->dyn_eq_offs[k] + j];
    }
    c->fill(HESSIAN); /* and the Lagrangian's slope by the rows, into gradient */
    for (int k = 0, b = 0; k < c->stages; ++k) {
        int at = c->start[k], high = c->nx[k] + c->nu[k];
        if (k) /* Fatrop's Lagrangian has lam' F, without the next state. */
            for (int j = 0; j < c->nx[k]; ++j) c->gradient[at + j] += lam[s->dyn_eq_offs[k - 1] + j];
        for (int j = 0; j < c->inequalities[k]; ++j, ++b)
            if (c->bounded_row[b] < 0) c->gradient[c->bounded_w[b]] += lam[s->g_ineq_offs[k] + j];
        clear(res + k, high, high);
        for (int i = 0; i < c->nx[k]; ++i) BLASFEO_DMATEL(res + k, high, c->nu[k] + i) = c->gradient[at + i];
        for (int i = 0; i < c->nu[k]; ++i) BLASFEO_DMATEL(res + k, high, i) = c->gradient[at + c->nx[k] + i];
    }
    put(c->hessian_entries, 1.0, c->hessian, res);
    return 1;
}

long interface_bytes(void) { return sizeof(struct FatropOcpCInterface); }

void connect(struct FatropOcpCInterface *f, Chain *c) {
    memset(f, 0, sizeof *f);
    f->get_nx = dim_nx;
    f->get_nu = dim_nu;
    f->get_ng = dim_equal;
    f->get_ng_ineq = dim_bounded;
    f->get_horizon_length = dim_stages;
    f->get_n_stage_params = no_dim;
    f->get_n_global_params = no_dims;
    f->get_default_stage_params = no_values;
    f->get_default_global_params = no_globals;
    f->get_bounds = bounds;
    f->get_initial_xk = initial_x;
    f->get_initial_uk = initial_u;
    f->full_eval_constr_jac = constraint_slopes;
    f->full_eval_contr_viol = constraint_values;
    f->full_eval_obj_grad = objective_slope;
    f->full_eval_obj = objective_value;
    f->full_eval_lag_hess = lagrangian_hessian;
    f->user_data = c;
}

/* The unknowns of a solved chain, in w's order. */
void unknowns(Chain *c, const struct blasfeo_dvec *primal) { read_unknowns(c, primal->pa); }

int iterations(const struct FatropOcpCStats *s) { return s->iterations_count; }
int flag(const struct FatropOcpCStats *s) { return s->return_flag; }

/* A thread that gets this signal sleeps for good, with all that it holds: Fatrop's search for a definite Hessian has
   no end where rows are dependent, and nobody it asks. */
static void sleep_on(int number) { (void)number; for (;;) pause(); }

int sleep_signal(void) {
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = sleep_on;
    int number = SIGRTMIN + 11;
    return sigaction(number, &action, 0) ? -1 : number;
}
