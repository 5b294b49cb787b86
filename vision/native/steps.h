/* What the fits of markers keep from step to step. */
#ifndef SKYHERD_STEPS_H
#define SKYHERD_STEPS_H

#include "marker_pixels.h"

/* The markers of a fit, (count,) each. */
typedef struct {
    Pixels *pixels;
    Homography *start, *here;
    Appearance *appearances;
    double *moved_px;
    uint8_t *is_active, *right;
    Solutions free, held;
    Complex middle;
    int round_in_image;
} Steps;

int32_t allocate_steps(Steps *steps, const FitRequest *given);
void release_steps(Steps *steps, int64_t count);
void to_floats(const double *from, int64_t count, float *to);
void step_marker(const FitRequest *given, Steps *steps, int64_t k);
int learn_surroundings(const FitRequest *given, Steps *steps, int64_t k);
void put_on_plane(const Plane *plane, Steps *steps, int64_t k);
int32_t write_fits(const FitRequest *given, const Steps *steps, const Plane *plane, Fit *fits, double *cell_means);

#endif
