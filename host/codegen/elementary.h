/* sin, cos, exp, tanh and atan2 over lanes, to 4 units in the last place. Behind simd.h.

   Reductions and polynomials are those of fdlibm (Sun Microsystems, 1993; k_sin.c, k_cos.c, e_exp.c, s_atan.c), without
   its tables and branches. A lane outside the range of a reduction, such as one that diverged, takes libm's value
   and leaves the others as they are. */

typedef long long Half __attribute__((vector_size(4 * LANES)));
INLINE int any(M m) {
    Half halves[2];
    memcpy(halves, &m, sizeof m);
    Half both = halves[0] | halves[1];
    long long bits = 0;
    for (int i = 0; i < LANES / 2; ++i) bits |= both[i];
    return bits != 0;
}

/* Replaces the results of the lanes in `outside`. Marked cold, so that the vector code keeps its registers. */
static __attribute__((noinline, cold)) void by_libm(double (*call)(double), const V *a, const M *outside, V *result) {
    for (int i = 0; i < LANES; ++i) if ((*outside)[i]) (*result)[i] = call((*a)[i]);
}
static __attribute__((noinline, cold)) void by_libm2(double (*call)(double, double), const V *a, const V *b,
                                                     const M *outside, V *result) {
    for (int i = 0; i < LANES; ++i) if ((*outside)[i]) (*result)[i] = call((*a)[i], (*b)[i]);
}
/* NaN is outside of every range. */
#define IN_RANGE(name, call, vectors, low, high) \
    INLINE V name(V a) { \
        V result = vectors(a); \
        M outside = ~((a >= low) & (a <= high)); \
        if (__builtin_expect(any(outside), 0)) { \
            V argument = a, repaired = result; \
            M which = outside; \
            by_libm(call, &argument, &which, &repaired); \
            result = repaired; \
        } \
        return result; \
    }

/* Adding it rounds to an integer, which the last bits of the sum then are. */
#define ROUNDER 6755399441055744.0

/* The nearest multiple of pi / 2, whose number is in the last two bits of *quadrant, and the rest. */
INLINE V quarter_turns(V a, M *quadrant) {
    V t = a * 6.36619772367581382433e-01 + ROUNDER, n = t - ROUNDER;
    *quadrant = (M)t;
    return ((a - n * 1.57079632673412561417e+00) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
}
INLINE V near_sin(V r) {
    V z = r * r;
    V p = z * 1.58969099521155010221e-10 - 2.50507602534068634195e-08;
    p = p * z + 2.75573137070700676789e-06; p = p * z - 1.98412698298579493134e-04;
    p = p * z + 8.33333333332248946124e-03; p = p * z - 1.66666666666666324348e-01;
    return r * (1.0 + z * p);
}
INLINE V near_cos(V r) {
    V z = r * r, half = 0.5 * z, w = 1.0 - half;
    V p = z * -1.13596475577881948265e-11 + 2.08757232129817482790e-09;
    p = p * z - 2.75573143513906633035e-07; p = p * z + 2.48015872894767294178e-05;
    p = p * z - 1.38888888888741095749e-03; p = p * z + 4.16666666666666019037e-02;
    return w + (((1.0 - w) - half) + z * z * p);
}
/* The sine of r plus `quadrant` quarter turns. */
INLINE V turned(V r, M quadrant) {
    V value = choose((quadrant & 1) == 0, near_sin(r), near_cos(r));
    return (V)((M)value ^ (quadrant << 62 & ~0x7fffffffffffffffLL));
}
INLINE V sin_reduced(V a) { M q; V r = quarter_turns(a, &q); return turned(r, q); }
INLINE V cos_reduced(V a) { M q; V r = quarter_turns(a, &q); return turned(r, q + 1); }
#define LARGEST_ANGLE 1024.0
IN_RANGE(vsin, sin, sin_reduced, -LARGEST_ANGLE, LARGEST_ANGLE)
IN_RANGE(vcos, cos, cos_reduced, -LARGEST_ANGLE, LARGEST_ANGLE)

/* exp(a) = power (1 + 2 r / d): a = n ln(2) + r, power = 2^n. */
typedef struct { V r, d, power; } Exponential;
INLINE Exponential exponential(V a) {
    V t = a * 1.44269504088896338700 + ROUNDER, n = t - ROUNDER;
    V r = (a - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10, z = r * r;
    V p = (z * z) * (z * (z * 4.13813679705723846039e-08 - 1.65339022054652515390e-06) + 6.61375632143793436117e-05)
        + (1.66666666666666019037e-01 - z * 2.77777777770155933842e-03);
    return (Exponential){r, 2.0 - (r - z * p), (V)(((M)t + 1023) << 52)};
}
INLINE V exp_reduced(V a) {
    Exponential e = exponential(a);
    return e.power + e.power * (2.0 * e.r / e.d);
}
IN_RANGE(vexp, exp, exp_reduced, -708.0, 709.0)

/* (exp(2 b) - 1) / (exp(2 b) + 1), both times d, for b = |a|; from 20 on it is 1. */
INLINE V vtanh(V a) {
    V b = vabs(a);
    Exponential e = exponential(2.0 * choose(b > 20.0, splat(20.0), b));
    V above = 2.0 * e.r * e.power + (e.power - 1.0) * e.d;
    V y = above / (above + 2.0 * e.d);
    return (V)((M)y | ((M)a & ~0x7fffffffffffffffLL));
}

/* atan of small / large in the first octant; beyond pi / 8 by its distance from pi / 4. */
INLINE V octant(V small, V large) {
    M far = small > 0.414213562373095 * large;
    V x = choose(far, small - large, small) / choose(far, small + large, large), z = x * x;
    V p = z * 1.62858201153657823623e-02 - 3.65315727442169155270e-02;
    p = p * z + 4.97687799461593236017e-02; p = p * z - 5.83357013379057348645e-02;
    p = p * z + 6.66107313738753120669e-02; p = p * z - 7.69187620504482999495e-02;
    p = p * z + 9.09088713343650656196e-02; p = p * z - 1.11111104054623557880e-01;
    p = p * z + 1.42857142725034663711e-01; p = p * z - 1.99999999998764832476e-01;
    p = p * z + 3.33333333333329318027e-01;
    V rest = x * z * p;
    return choose(far, 7.85398163397448278999e-01 - ((rest - 3.06161699786838301793e-17) - x), x - rest);
}
INLINE V vatan2(V y, V x) {
    V across = vabs(x), up = vabs(y);
    M steep = up > across;
    V small = choose(steep, across, up), large = choose(steep, up, across);
    V angle = octant(small, large);
    angle = choose(steep, 1.57079632679489655800e+00 - (angle - 6.12323399573676603587e-17), angle);
    angle = choose(x < 0.0, 3.14159265358979311600e+00 - (angle - 1.22464679914735317722e-16), angle);
    V result = (V)((M)angle | ((M)y & ~0x7fffffffffffffffLL));
    M outside = ~((large >= 1e-150) & (large <= 1e150) & (small == small));
    if (__builtin_expect(any(outside), 0)) {
        V first = y, second = x, repaired = result;
        M which = outside;
        by_libm2(atan2, &first, &second, &which, &repaired);
        result = repaired;
    }
    return result;
}
