/* Eight single-precision numbers at a time, and the normal density and distribution of them.
 *
 * The lanes are the same in all builds, so that all give equal bytes.
 */
#ifndef SKYHERD_FLOATS_H
#define SKYHERD_FLOATS_H

#include <math.h>
#include <stdint.h>

enum { LANES = 8 };

typedef float Floats __attribute__((vector_size(4 * LANES)));
typedef int32_t Ints __attribute__((vector_size(4 * LANES)));

#define INLINE static inline __attribute__((always_inline))

INLINE Floats all(float value) { return value - (Floats){0}; }
INLINE Floats choose(Ints where, Floats a, Floats b) { return (Floats)(((Ints)a & where) | ((Ints)b & ~where)); }
INLINE Floats larger(Floats a, Floats b) { return choose(a > b, a, b); }
INLINE Floats smaller(Floats a, Floats b) { return choose(a < b, a, b); }
INLINE Floats absolute(Floats a) { return (Floats)((Ints)a & 0x7fffffff); }
INLINE Ints whole(Floats a) { return __builtin_convertvector(a, Ints); }
INLINE Floats number(Ints a) { return __builtin_convertvector(a, Floats); }

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
