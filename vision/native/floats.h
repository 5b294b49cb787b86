/* Eight or sixteen single-precision numbers at a time, and the normal density and distribution of them.
 *
 * Each lane is computed alone, and sums in double precision have eight lanes in all builds, so that all give equal bytes.
 */
#ifndef SKYHERD_FLOATS_H
#define SKYHERD_FLOATS_H

#include <math.h>
#include <stdint.h>
#include <string.h>

/* Numbers at a time. A file whose sums over lanes are to be the same in all builds defines FLOATS_LANES itself. */
#if defined(FLOATS_LANES)
enum { LANES = FLOATS_LANES };
#elif defined(__AVX512F__)
enum { LANES = 16 };
#else
enum { LANES = 8 };
#endif

enum { EIGHT = 8 };

typedef float Floats __attribute__((vector_size(4 * LANES)));
typedef int32_t Ints __attribute__((vector_size(4 * LANES)));
typedef float EightFloats __attribute__((vector_size(4 * EIGHT)));
typedef int32_t EightInts __attribute__((vector_size(4 * EIGHT)));
typedef double Doubles __attribute__((vector_size(8 * EIGHT)));

#define INLINE static inline __attribute__((always_inline))

INLINE Floats load(const float *at) {
    Floats values;
    memcpy(&values, at, sizeof values);
    return values;
}

INLINE void store(Floats values, float *at) { memcpy(at, &values, sizeof values); }

INLINE Floats all(float value) { return value - (Floats){0}; }
INLINE Floats choose(Ints where, Floats a, Floats b) { return (Floats)(((Ints)a & where) | ((Ints)b & ~where)); }
INLINE Floats larger(Floats a, Floats b) { return choose(a > b, a, b); }
INLINE Floats smaller(Floats a, Floats b) { return choose(a < b, a, b); }
INLINE Floats absolute(Floats a) { return (Floats)((Ints)a & 0x7fffffff); }
INLINE Ints whole(Floats a) { return __builtin_convertvector(a, Ints); }
INLINE Floats number(Ints a) { return __builtin_convertvector(a, Floats); }

/* Add numbers to eight sums in double precision, eight after eight. */
INLINE void add_in_double(Floats values, Doubles *sums) {
    EightFloats eight[LANES / EIGHT];
    memcpy(eight, &values, sizeof eight);
    for (int i = 0; i < LANES / EIGHT; i++) *sums += __builtin_convertvector(eight[i], Doubles);
}

/* Return the sum of all lanes: of those 4, 2 and 1 apart, in this order. */
INLINE double sum_of(Doubles a) {
    for (int apart = EIGHT / 2; apart; apart /= 2)
        for (int i = 0; i < apart; i++) a[i] += a[i + apart];
    return a[0];
}

INLINE Floats square_root(Floats a) {
    for (int i = 0; i < LANES; i++) a[i] = sqrtf(a[i]);
    return a;
}

/* Distance in standard deviations beyond which φ is 0, and log2 of exp(-z² / 2) there, rounded down. Derived: Φ is within
 * 1e-9 of its limits, a sixtieth of what single precision resolves. Without it, densities and their squares would be below
 * the smallest normal number, 1e-38, for which processors take up to a hundred times as long. */
static const float FAR_SIGMAS = 6.0f, FAR_POWER = -26.0f;

/* Return φ(z) = exp(-z² / 2) / √(2 π). The power of 2 is split into a whole one and a series, to 6e-8 of itself. */
INLINE Floats bell(Floats z) {
    const Floats power = larger(-0.72134752044f * z * z, all(FAR_POWER)); /* log2 of exp(-z² / 2) */
    const Ints integer = whole(power - 0.5f);
    const Floats x = 0.69314718056f * (power - number(integer)); /* within ln(2) / 2 */
    Floats series = 1.0f + x * (1.0f / 6.0f);
    series = 1.0f + x * (1.0f / 5.0f) * series;
    series = 1.0f + x * (1.0f / 4.0f) * series;
    series = 1.0f + x * (1.0f / 3.0f) * series;
    series = 1.0f + x * (1.0f / 2.0f) * series;
    series = 1.0f + x * series;
    const Floats density = 0.39894228040f * (Floats)((integer + 127) << 23) * series;
    return choose(absolute(z) < FAR_SIGMAS, density, (Floats){0});
}

/* Return Φ(z), given φ(z), to 8e-8: M. Abramowitz, I. Stegun, Handbook of Mathematical Functions, 26.2.17. */
INLINE Floats step(Floats z, Floats density) {
    const Floats t = 1.0f / (1.0f + 0.2316419f * absolute(z));
    Floats series = 1.330274429f * t - 1.821255978f;
    series = series * t + 1.781477937f;
    series = series * t - 0.356563782f;
    series = (series * t + 0.319381530f) * t;
    const Floats tail = density * series;
    return choose(z > 0, 1.0f - tail, tail);
}

#endif
