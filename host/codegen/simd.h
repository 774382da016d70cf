/* Vectors of LANES doubles: operations, and functions that work lane by lane. A vector is one register of the
   target: wider ones spill, narrower ones leave units idle. Results do not depend on the width. */

#ifndef LANES
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else /* SSE2, NEON */
#define LANES 2
#endif
#endif
#include <math.h>
#include <string.h>
typedef double V __attribute__((vector_size(8 * LANES)));
typedef long long M __attribute__((vector_size(8 * LANES)));
int lane_count(void) { return LANES; }
#define INLINE static inline __attribute__((always_inline))
#define LANEWISE(name, call) \
    INLINE V name(V a) { V r; for (int i = 0; i < LANES; ++i) r[i] = call(a[i]); return r; }
#define LANEWISE2(name, call) \
    INLINE V name(V a, V b) { V r; for (int i = 0; i < LANES; ++i) r[i] = call(a[i], b[i]); return r; }
LANEWISE(vsqrt, sqrt) LANEWISE(vsin, sin) LANEWISE(vcos, cos) LANEWISE(vtan, tan) LANEWISE(vasin, asin)
LANEWISE(vacos, acos) LANEWISE(vatan, atan) LANEWISE(vlog, log) LANEWISE(vfloor, floor) LANEWISE(vceil, ceil)
LANEWISE(vsinh, sinh) LANEWISE(vcosh, cosh)
LANEWISE2(vatan2, atan2) LANEWISE2(vpow, pow) LANEWISE2(vfmod, fmod) LANEWISE2(vcopysign, copysign)
INLINE V splat(double a) { return (V){} + a; }
INLINE V choose(M m, V a, V b) { return (V)(((M)a & m) | ((M)b & ~m)); }
INLINE V truth(M m) { return choose(m, splat(1.0), splat(0.0)); }
INLINE V vmin(V a, V b) { return choose(a < b, a, b); }
INLINE V vmax(V a, V b) { return choose(a > b, a, b); }
INLINE V vabs(V a) { return (V)((M)a & 0x7fffffffffffffffLL); }
INLINE V vsign(V a) { return choose(a > 0.0, splat(1.0), choose(a < 0.0, splat(-1.0), a)); }
/* Cody and Waite's reduction, Taylor's polynomial on |r| <= ln(2) / 2. */
INLINE V vexp(V a) {
    V x = vmin(vmax(a, splat(-708.0)), splat(709.0));
    V t = x * 1.4426950408889634 + 6755399441055744.0, n = t - 6755399441055744.0;
    V r = (x - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10;
    V p = splat(1.0 / 6227020800.0);
    p = p * r + 1.0 / 479001600.0; p = p * r + 1.0 / 39916800.0; p = p * r + 1.0 / 3628800.0;
    p = p * r + 1.0 / 362880.0; p = p * r + 1.0 / 40320.0; p = p * r + 1.0 / 5040.0;
    p = p * r + 1.0 / 720.0; p = p * r + 1.0 / 120.0; p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0; p = p * r + 0.5; p = p * r + 1.0; p = p * r + 1.0;
    return p * (V)(((M)t + 1023) << 52);
}
INLINE V vtanh(V a) {
    V b = vmin(vabs(a), splat(20.0));
    V y = 1.0 - 2.0 / (vexp(2.0 * b) + 1.0);
    return (V)((M)y | ((M)a & ~0x7fffffffffffffffLL));
}
