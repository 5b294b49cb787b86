/* Markers followed from one image of a camera to the next, in one call (vision/photometric/following.py).
 *
 * follow.c has the stages:
 *   1. tracks.c        where markers are predicted, and whether they are in view
 *   2. marker_fit.c    their fits
 *   3. verify.c        whether each fit leaves only noise
 *   4. streak_test.c   whether the image has a streak of motion
 *   5. estimates.c     what is learned of the camera, and the detections
 * The call goes on as long as all is as usual: every marker in view is fitted, verified and fully visible under the blur that
 * was assumed. Otherwise it ends after the fit, and Python goes on from there. Names are those of the Python modules.
 */
#ifndef SKYHERD_FOLLOW_H
#define SKYHERD_FOLLOW_H

#include "marker_pixels.h"

/* Why following ended; 0 if all is as usual. */
enum { FOLLOW_USUAL, FOLLOW_NOT_FITTED, FOLLOW_FITTED };

/* A marker as it was last seen (tracks.py). */
typedef struct {
    int64_t id;
    double time_s;
    Homography homography;
    Complex velocity, similarity_log_rate; /* px/s, 1/s */
    int64_t on_arc;
    double sigma_px;
    Surroundings around;
    int64_t missed;
} Track;

/* Estimates of a camera (state.py); lengths in px, levels in grey levels. Those that are not known are NaN. */
typedef struct {
    double sigma_px, noise, contrast, print_contrast;
    double ratio_sums[2], ratio_boxes; /* PooledRatios of fitting/correlated_noise.py */
} Estimates;

/* Limits of verification (verify.py), those that depend on the dictionary as it needs them. */
typedef struct {
    double wrong_cell_share, wrong_cell_sigmas, wrong_cell_limit, strong_cell_limit, weak_cell_share;
    double min_contrast, max_white, max_cell_noise, max_anisotropy, max_keystone, max_blur_cells, max_last_step_px;
    double min_cell_px, min_area_share, noise_factor, model_share, cell_model_share, sharp_blur_cells, max_processed_noise;
    double wrong_bits, min_print_share, min_divisor_contrast;
    double first_log_sigma, last_log_sigma; /* of both tables */
    const double *own_cell, *square;        /* (table_size,) integrals of E over the wrong cell, and of E² */
    int32_t table_size, is_strong;
} VerificationLimits;

/* Constants of following; the Python modules that have them say why. */
typedef struct {
    double reach_sides, max_log_growth;                                             /* tracks.py */
    double max_side_px, max_log_blur_difference;                                    /* refine.py */
    double streak_pixels, significant, min_streak_px2, streak_ridge;                /* refine.py, streak_evidence.py */
    double outlier_share, outlier_sigmas;                                           /* fitting/fit.py */
    double rounding_noise, median_difference;                                       /* image_noise.py */
    double learning_rate, forgotten, significant_ratio_error, min_ratio, max_ratio; /* state.py, correlated_noise.py */
    AppearanceConstants looks;
    BlurConstants blur;
    VerificationLimits verification;
    int32_t max_missed, streak_markers, saturation_margin, min_unsaturated_pixels;
} FollowConstants;

/* Image, tracks and estimates of a camera. */
typedef struct {
    const uint8_t *image;           /* (height, width) */
    const Track *tracks;            /* (count,), ids ascend */
    const float *cells;             /* (count, n + 2, n + 2), as in `Scene` */
    const FitConstants *fit_constants;
    const FollowConstants *constants;
    int64_t height, width, count;
    double time_s, noise;           /* of the image; standard deviation of a pixel as far as it is known, grey levels */
    Estimates estimates;
    int32_t n, max_steps;
} FollowRequest;

/* A detection (messages/detections.py). */
typedef struct { Complex center; double heading_rad, side_px; Complex corners[4]; double covariance[9]; } Detection;

/* Results. Markers in view are the first `here` of the arrays of the fit. */
typedef struct {
    int64_t *rows, *should_be_seen; /* (count,) tracks in view; which tracks should be seen */
    Homography *starts;             /* (count,) of the markers in view */
    double *blurs;                  /* (count,) assumed, in sides */
    Fit *fits;                      /* (count,) */
    double *cell_means;             /* (count, n, n) */
    Plane *plane;                   /* the known one, and then the one found */
    Track *tracks;                  /* (count,) after the image */
    Detection *detections;          /* (count,) of the markers in view */
    Estimates estimates;            /* after the image */
    int64_t here, track_count;
} FollowResults;

enum { MAX_STREAK_MARKERS = 8 };

/* A weighted value of a median. */
typedef struct { double value, weight; } Weighted;

double weighted_median(Weighted *values, int64_t count);
void predict(const Track *track, double time_s, double max_log_growth, Homography *place);
double shift_sides(const Homography *before, const Homography *after);
void find_in_view(const FollowRequest *given, FollowResults *results);
void update_tracks(const FollowRequest *given, const double *sigmas_px, FollowResults *results);
int are_verified(const VerificationLimits *limits, const Fit *fits, const double *cell_means, const double *blurs,
                 int64_t count, int32_t n, double noise, Weighted *scratch);
int32_t has_streak(const FollowRequest *given, const FollowResults *results, const float *cells, double noise);
void learn(const FollowRequest *given, Weighted *scratch, double *sigmas_px, FollowResults *results);
int32_t follow_markers(const FollowRequest *given, FollowResults *results);

#endif
