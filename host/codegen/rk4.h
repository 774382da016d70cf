/* Runge-Kutta of fourth order over lanes. Behind simd.h.

   Evaluation q of a step of h seconds is at x + ALONG[q] h times the slope before it, at half step HALF(q) of the
   drive. The step is h times the sum of WEIGHT[q] times slope q. */

static const double ALONG[4] = {0.0, 0.5, 0.5, 1.0}, WEIGHT[4] = {1.0 / 6, 2.0 / 6, 2.0 / 6, 1.0 / 6};
#define HALF(q) (((q) + 1) / 2)

/* Where evaluation q is. */
INLINE void rk4_at(int size, int q, V step, const V *x, const V *slope, V *at) {
    for (int i = 0; i < size; ++i) at[i] = q ? x[i] + ALONG[q] * step * slope[i] : x[i];
}
