/* A network's layers over lanes. Behind simd.h. Weights: for every output its inputs' weights, then its bias. */

/* Outputs j to j + BLOCK - 1, whose sums are independent and so hide the latency of an addition. */
#define OUTPUTS(BLOCK) \
    for (; j + BLOCK <= outputs; j += BLOCK) { \
        const double *a = w + (long)j * (inputs + 1); \
        V s[BLOCK]; \
        for (int q = 0; q < BLOCK; ++q) s[q] = splat(a[q * (inputs + 1) + inputs]); \
        for (int i = 0; i < inputs; ++i) for (int q = 0; q < BLOCK; ++q) s[q] += a[q * (inputs + 1) + i] * u[i]; \
        for (int q = 0; q < BLOCK; ++q) out[j + q] = s[q]; \
    }
INLINE void layer(const double *w, const V *u, V *out, int inputs, int outputs) {
    int j = 0;
    OUTPUTS(8)
    OUTPUTS(3)
    OUTPUTS(1)
}

/* out = weights' transposed times back. */
INLINE void layer_back(const double *w, const V *back, V *out, int inputs, int outputs) {
    for (int i = 0; i < inputs; ++i) out[i] = splat(0.0);
    int j = 0;
    for (; j + 4 <= outputs; j += 4) {
        const double *a = w + (long)j * (inputs + 1), *b = a + inputs + 1, *c = b + inputs + 1, *d = c + inputs + 1;
        V t0 = back[j], t1 = back[j + 1], t2 = back[j + 2], t3 = back[j + 3];
        for (int i = 0; i < inputs; ++i) out[i] += (a[i] * t0 + b[i] * t1) + (c[i] * t2 + d[i] * t3);
    }
    for (; j < outputs; ++j) {
        const double *a = w + (long)j * (inputs + 1);
        V t = back[j];
        for (int i = 0; i < inputs; ++i) out[i] += a[i] * t;
    }
}

/* before (outputs, ways) = weights times slope (inputs, ways), without biases. */
INLINE void layer_slope(const double *w, const V *slope, V *before, int inputs, int outputs, int ways) {
    int j = 0;
    for (; j + 2 <= outputs; j += 2) {
        const double *a = w + (long)j * (inputs + 1), *b = a + inputs + 1;
        for (int q = 0; q < ways; q += 3) {
            V s[2][3];
            for (int r = 0; r < 3; ++r) s[0][r] = s[1][r] = splat(0.0);
            for (int i = 0; i < inputs; ++i) {
                const V *t = slope + i * ways + q;
                for (int r = 0; r < 3; ++r) { s[0][r] += a[i] * t[r]; s[1][r] += b[i] * t[r]; }
            }
            for (int r = 0; r < 3; ++r) { before[j * ways + q + r] = s[0][r]; before[(j + 1) * ways + q + r] = s[1][r]; }
        }
    }
    for (; j < outputs; ++j) {
        const double *a = w + (long)j * (inputs + 1);
        for (int q = 0; q < ways; ++q) {
            V s = splat(0.0);
            for (int i = 0; i < inputs; ++i) s += a[i] * slope[i * ways + q];
            before[j * ways + q] = s;
        }
    }
}
