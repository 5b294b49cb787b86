/* Complex numbers of double precision. */
#ifndef SKYHERD_COMPLEX_NUMBERS_H
#define SKYHERD_COMPLEX_NUMBERS_H

#include <math.h>

typedef struct { double re, im; } Complex;

static inline Complex complex_of(double re) { return (Complex){re, 0}; }
static inline Complex plus(Complex a, Complex b) { return (Complex){a.re + b.re, a.im + b.im}; }
static inline Complex minus(Complex a, Complex b) { return (Complex){a.re - b.re, a.im - b.im}; }
static inline Complex conjugate(Complex a) { return (Complex){a.re, -a.im}; }
static inline Complex scaled(Complex a, double by) { return (Complex){a.re * by, a.im * by}; }
static inline Complex times_i(Complex a) { return (Complex){-a.im, a.re}; }
static inline double squared(Complex a) { return a.re * a.re + a.im * a.im; }
static inline double magnitude(Complex a) { return sqrt(squared(a)); }

static inline Complex times(Complex a, Complex b) {
    return (Complex){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

static inline Complex over(Complex a, Complex b) { return scaled(times(a, conjugate(b)), 1 / squared(b)); }

#endif
