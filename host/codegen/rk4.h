/* Runge-Kutta of fourth order over lanes. Behind simd.h.

   Evaluation q of a step of h seconds is at x + ALONG[q] h times the slope before it, at half step HALF(q) of the
   drive. The step is h / 6 times the sum of SHARE[q] times slope q. */

static const double ALONG[4] = {0.0, 0.5, 0.5, 1.0}, SHARE[4] = {1.0, 2.0, 2.0, 1.0};
#define HALF(q) (((q) + 1) / 2)

/* Where evaluation q is. */
INLINE void rk4_at(int size, int q, V h, const V *x, const V *slope, V *at) {
    for (int i = 0; i < size; ++i) at[i] = q ? x[i] + ALONG[q] * h * slope[i] : x[i];
}

/* total becomes the weighted sum of the slopes up to q. */
INLINE void rk4_sum(int size, int q, const V *slope, V *total) {
    for (int i = 0; i < size; ++i) total[i] = q ? total[i] + SHARE[q] * slope[i] : slope[i];
}
