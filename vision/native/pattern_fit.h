/* Fits of drawn patterns to the readings of candidates (vision/photometric/evidence/pattern_fit.py has the model). */
#ifndef SKYHERD_PATTERN_FIT_H
#define SKYHERD_PATTERN_FIT_H

#include "fit.h"

enum { PARTS = 3 }; /* parts of a cell along its side */

/* Constants of the fit; pattern_fit.py says why. */
typedef struct {
    double card_outliers, zone_outliers, outlier_range, first_zone_share, usual_std, usual_std_parts, first_std;
    double gradient_std, log_contrast_std, rounding_std, ridge, min_contrast;
    int64_t iterations;
} PatternConstants;

/* Readings of candidates, in side x side parts with side = PARTS (n + 2), and patterns for each of them. */
typedef struct {
    const float *levels, *seen;     /* (count, side, side) grey levels; 0 where glare saturates a part, else 1 */
    const double *scales, *weights, *ranges; /* (count,) */
    const float *patterns;          /* (count, each, side, side) whiteness */
    const float *ground_shares;     /* (grounds, side, side) of a ground with a level of its own */
    const PatternConstants *constants;
    int64_t count, each;            /* candidates, and patterns for each */
    int64_t grounds;                /* 0: none; 1: the same for all; count: one each */
    int32_t n;                      /* cells along a marker's side */
    int32_t any_contrast;           /* whether the contrast need not explain the range of the readings */
} PatternRequest;

/* Fit of one pattern. */
typedef struct {
    double log;                     /* log likelihood with the priors of light and contrast; -inf without contrast */
    double levels[6];               /* b, c, g, h, p, q, grey levels */
    double std;                     /* noise, in units of the candidate's range */
    double outlier_share;           /* of the parts on the marker */
} PatternFit;

int32_t best_rectangles(const double *sums, int64_t count, int32_t edges, const double *unexplained, int32_t each,
                        int32_t *rectangles, double *gains);
int32_t fit_patterns(const PatternRequest *given, PatternFit *fits);

#endif
