/* The fit of markers to an image's own pixels.
 *
 * marker_fit.c has the fit from start to end: Gauss-Newton steps in all unknowns of all markers of an image. A step calls
 * the functions of these files, one after the other:
 *   1. pixels.c          which pixels a marker has, and where on the marker they lie
 *   2. round_blur.c, elliptic_blur.c   the model's columns at these pixels, under either kind of blur
 *   3. sums.c            products of the columns; residuals, and their sums over cells and over boxes
 *   4. least_squares.c   the solution, with unknowns free, held or expected
 *   5. common_unknowns.c what all markers share: even light, the tone curve, the plane (plane_fit.c)
 * marker_pixels.c does steps 1 to 4 for one marker. any_blur.c fits markers of all sizes until they have found their blur.
 * visible_fit.c fits those pixels of markers that agree, where something covers the others. free_fit.c fits markers that share
 * no plane. streak.c asks settled markers for a streak of motion. homography.h has the geometry of a marker. image_noise.c
 * reads the noise of an image from the image alone.
 *
 * The formulas are those of vision/photometric/fitting/design_matrix.py. Pixels are in the order of the markers, line by
 * line. All sums run in one order, so that all builds give equal
 * bytes. Lengths are in marker sides, unless a unit is given; x is to the marker's right, y down.
 */
#ifndef SKYHERD_FIT_H
#define SKYHERD_FIT_H

#include <stddef.h>
#include <stdint.h>

#include "complex_numbers.h"
#include "floats.h"

/* Columns of the model, and the pixels' own values; design_matrix.py has the same names, and the formulas. */
enum {
    BLACK, CONTRAST, RIGHT, DOWN, TURN, GROW, BLUR, GROUND, ANISOTROPY_X, ANISOTROPY_Y, LIGHT_X, LIGHT_Y,
    KEYSTONE_X, KEYSTONE_Y, TONE, PIXEL, COLUMNS, UNKNOWNS = PIXEL
};

enum { MAX_CELLS = 20, BLOCK_PX = 16 };

/* Grey level that is subtracted from the pixels, so that sums of their squares keep their digits in single precision.
 * Chosen: the middle of the 8-bit range. */
enum { MIDDLE_GREY = 128 };

/* Negative results of the functions. */
enum { FIT_INVALID_SIZE = -4, FIT_NO_MEMORY = -5 };

/* Geometry and appearance of a marker, as its pixels are listed and drawn. */
typedef struct {
    Complex center;                 /* px */
    Complex x_axis, y_axis;         /* axes X and Y of the homography, sides per px */
    Complex perspective;            /* h, 1/px */
    Complex keystone, anisotropy;   /* of blur that is round in the image; 0 for blur that is round in the marker */
    double limit;                   /* largest |x| and |y| of its pixels */
    double strip;                   /* the same of the affine part, wide enough for the perspective */
    double height_px;               /* half the height of the strips' common part, px */
    double sigma;                   /* standard deviation of the blur */
    double black_ratio;             /* black level over contrast */
    double half_card;               /* distance of the card's edge from the centre; infinite if no ground is seen */
    double x_stretch, y_stretch;    /* standard deviations of the blur along x and y, over sigma */
    double ground_level;            /* ground less white, over contrast, for a marker without a card; otherwise 0 */
    int64_t is_bare;                /* whether the marker has no card, and the ground begins at its border */
} Marker;

/* Pixels of markers, and the model's columns at them: 0 for pixels that are not used. They are kept in blocks of BLOCK_PX,
 * so that one instruction reads a value of many pixels. A marker's last block repeats its last pixel, with columns of 0. */
typedef struct {
    const int64_t *bounds;          /* (count + 1,): marker k has the blocks from bounds[k] to bounds[k + 1] */
    const int64_t *counts;          /* (count,): pixels of each marker */
    const float *places;            /* (blocks, 2, BLOCK_PX), x and y */
    const int32_t *pixels;          /* (blocks, 2, BLOCK_PX), v and u */
    float *columns;                 /* (blocks, 16, BLOCK_PX) */
    int64_t count, blocks;
} MarkerBlocks;

/* Image and markers: the arguments of both functions that fill in columns. */
typedef struct {
    const uint8_t *image;           /* (height, width) */
    const Marker *markers;          /* (count,) */
    const float *cells;             /* (count, n + 2, n + 2), 1 where black, 0 where white and on the ground around */
    int64_t height, width;
    int32_t n;                      /* cells along a side */
    float texture_square;           /* variance of the ground's texture over that of the noise */
} Scene;

/* Image of a marker's plane; vision/photometric/fitting/local_homography.py has the symbols. */
typedef struct { Complex center, similarity, anisotropy, perspective; } Homography;

/* Ground around a marker without a card (fitting/surroundings.py): its level less white, over contrast, and its texture, grey
 * levels. The level is NaN for a marker on a card. */
typedef struct { double level, texture; } Surroundings;

/* Appearance of a marker at its size and blur (fitting/appearance.py). */
typedef struct {
    double sigma;                   /* standard deviation of the blur */
    double limit;                   /* largest |x| and |y| of its pixels */
    double half_card;               /* distance of the card's edge from the centre; infinite if no ground is seen */
    double black_ratio;             /* black level over contrast */
    Surroundings around;
} Appearance;

/* Plane of the markers (fitting/plane.py): α, λ and their covariance; shared is 0 where no plane explains the markers. */
typedef struct { Complex anisotropy, perspective, covariance[4]; int64_t shared; } Plane;

/* Limits of a plane (fitting/plane.py). */
typedef struct {
    double significant, excess;     /* fall of the chi-squared for two more unknowns, and chi-squared a degree of freedom */
    double converged, ridge;        /* last change, and share of the normal matrix's trace */
    double min_share;               /* of the markers that a plane must explain */
    int32_t min_markers, max_rounds;
} PlaneLimits;

/* Constants of the fit; the Python modules that have them say why. */
typedef struct {
    double ground_ridge, ridge, single_precision, min_squares, min_contrast;            /* fit.py */
    double max_growth, min_sigma, max_sigma;                                            /* design_matrix.py */
    double steep_anisotropy, min_variance_px2;                                          /* design_matrix.py */
    double min_print_share, free_sigmas, max_tone, keystone_std, near_plane;            /* common_unknowns.py */
    double max_step, min_step, settled_px, settled_perspective_px, off_cell;            /* fit.py */
    double max_log_blur, kept_share;                                                    /* fit_result.py, correlated_noise.py */
    PlaneLimits plane;                                                                  /* plane.py */
    int32_t min_markers_for_tone, min_pixels_for_plane, box_px, max_box_markers;
} FitConstants;

/* Markers to be fitted, and where the fit begins. */
typedef struct {
    const uint8_t *image;           /* (height, width) */
    const Homography *start;        /* (count,) */
    const Appearance *appearances;  /* (count,) */
    const float *cells;             /* (count, n + 2, n + 2), as in `Scene` */
    const FitConstants *constants;
    int64_t height, width, count;
    Complex streak_px2;             /* Q of the blur, px² (fitting/design_matrix.py) */
    double texture, noise;          /* ground's texture over the noise; noise in grey levels */
    int32_t n;                      /* cells along a side */
    int32_t max_steps, alone, has_streak;
} FitRequest;

/* How markers look under a blur (fitting/appearance.py); texture in grey levels. */
typedef struct { double quiet, outside_sigmas, inside_sigmas, ground_sigmas, texture, black_ratio; } AppearanceConstants;

/* Limits of the blur, and which fits are worth another, of so many steps (refine.py). */
typedef struct {
    double min_sigma_px, max_sigma_cells, settled, min_contrast, max_wrong_share;
    int32_t steps_per_round;
} BlurConstants;

/* Markers of any size under blurs that are not known. */
typedef struct {
    const FitRequest *markers;      /* where the first fit begins in the full-size image; appearances and texture are not used */
    const Surroundings *around;     /* (count,) */
    const AppearanceConstants *looks;
    const BlurConstants *limits;
    double max_side_px;             /* above which a marker is fitted in a shrunk image */
    int32_t rounds, is_fitted;      /* most rounds after the first fit, and whether that is known */
} BlurRequest;

/* Constants of the fit to visible pixels; fitting/occlusion.py says why. */
typedef struct {
    double inlier_sigmas, pixel_share, limit_factor, margin_sigmas, cover_share, min_visible_share, min_clear_share;
    int32_t final_rounds, min_cover_px;
} VisibleConstants;

/* Markers of which a part may be covered. */
typedef struct {
    const FitRequest *markers;      /* where the fit begins, with the black ratios of a fit to all pixels */
    const VisibleConstants *constants;
    const double *blacks, *contrasts, *sigmas_px;       /* (count,) levels of that fit, grey levels; blur, px */
    int64_t border;                 /* width of the border, cells */
    int32_t settled;                /* whether the fit begins where it ended, and finds the plane */
} VisibleRequest;

/* Result of the fit of a marker (fitting/fit_result.py). */
typedef struct {
    Homography homography;
    double covariance[9];           /* of u, v and heading, px and rad */
    double black, contrast, noise_std, peak;            /* grey levels */
    double log_blur, sigma_px, pixels, moved_px;
    double ratios[2], boxes;        /* fitting/correlated_noise.py */
    Surroundings around;
    double beside;                  /* mean residual of the pixels beside the marker, grey levels */
} Fit;

/* Least-squares solutions of markers (fitting/fit.py). */
typedef struct {
    double *values;                 /* (count, 15) */
    double *inverse_normals;        /* (count, 15, 15) */
    double *squares;                /* (count,) sums of squared residuals, grey levels squared */
    double *pixels;                 /* (count,) */
    int64_t count;
    int32_t free;                   /* number of unknowns that are not held */
} Solutions;

int64_t count_blocks(const Marker *markers, int64_t count, int64_t height, int64_t width);
int64_t list_pixels(const Marker *markers, int64_t count, int64_t height, int64_t width, int64_t *bounds, int64_t *counts,
                    float *places, int32_t *pixels, int64_t room);
int are_bounds_valid(const MarkerBlocks *given);
int32_t fill_round(const Scene *scene, const MarkerBlocks *given);
int32_t fill_elliptic(const Scene *scene, const MarkerBlocks *given, const double *blurs, float *bends);

int32_t gram_matrices(const MarkerBlocks *given, float *grams);
int32_t residuals(const MarkerBlocks *given, const float *solutions, float *left);
int32_t add_over_cells(const MarkerBlocks *given, const float *solutions, int32_t n, double *sums, double *used,
                       double *read, double *peaks, double *besides);
double ground_texture(const MarkerBlocks *given, const float *solution, double noise);
int32_t add_over_boxes(const MarkerBlocks *given, const int64_t *picked, int64_t picked_count, const float *solutions,
                       const float *influences, int32_t quantities, int32_t box_px, double *small, double *large,
                       int64_t *boxes);

int32_t count_second_differences(const uint8_t *image, int64_t height, int64_t width, int32_t darkest,
                                 int32_t brightest, int64_t *counts);

int32_t allocate_solutions(Solutions *solutions, int64_t count);
void release_solutions(Solutions *solutions);
void copy_solutions(const Solutions *from, Solutions *to);
void solve(const float *gram, const FitConstants *constants, Solutions *solutions, int64_t k);
void hold_at(Solutions *solutions, int32_t first, int32_t last, const double *at);
double noise_variance(const Solutions *solutions, int64_t k);
double contrast_of(const Solutions *solutions, int64_t k, const FitConstants *constants);
int32_t hold_unknowns(double *values, double *inverse_normals, double *squares, int64_t count, int32_t first,
                      int32_t last, const double *at, const double *variances);
int32_t hold_common_unknowns(const FitRequest *given, const Homography *start, const uint8_t *right, int settling,
                             const Solutions *free, Plane *plane, Solutions *held);
int32_t hold_visible_unknowns(const FitRequest *given, const Homography *start, const Solutions *free, int find,
                              Plane *plane, Solutions *held);
int32_t hold_light_and_tone(const FitRequest *given, const Homography *start, const Solutions *free, Solutions *held);
int32_t fit_plane(const PlaneLimits *limits, const Complex *points, const Complex *anisotropies, const double *variances,
                  int64_t count, int32_t most, Plane *plane);
int is_request_valid(const FitRequest *given);
int32_t streak_evidence(const FitRequest *given, double *informations, double *scores);
int32_t fit_markers(const FitRequest *given, Plane *plane, Fit *fits, double *cell_means);
Appearance appearance_of(const AppearanceConstants *constants, double sigma, Surroundings around);
double within_blur_limits(const BlurConstants *limits, const Fit *fit, int32_t n);
int is_promising(const BlurConstants *limits, const Fit *fit, const double *cell_means, int32_t n);
int32_t fit_any_blur(const BlurRequest *given, Plane *plane, double *sigmas_px, Fit *fits, double *cell_means, double *blurs);
int32_t fit_visible(const VisibleRequest *given, Plane *plane, Fit *fits, double *cell_means);
int32_t fit_freely(const FitRequest *given, double settled_px, Fit *fits, double *cell_means, double *covariances);

#endif
