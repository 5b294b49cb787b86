/* The linear model of markers at an image's own pixels: its columns, their products, and residuals.
 *
 * A step of a fit calls these functions, one after the other, on all markers of an image:
 *   1. pixels.c          which pixels a marker has, and where on the marker they lie
 *   2. round_blur.c, elliptic_blur.c   the model's columns at these pixels, under either kind of blur
 *   3. sums.c            products of the columns; residuals, and their sums over cells and over boxes
 *   4. held_unknowns.c   least squares with some unknowns held
 *   5. plane_fit.c       the plane that the markers lie on
 * image_noise.c reads the noise of an image from the image alone.
 *
 * The formulas are those of vision/photometric/fitting/design_matrix.py. Pixels are in the order of the markers, line by
 * line: marker k has the rows from bounds[k] to bounds[k + 1]. All sums run in one order, so that all builds give equal
 * bytes. Lengths are in marker sides, unless a unit is given; x is to the marker's right, y down.
 */
#ifndef SKYHERD_FIT_H
#define SKYHERD_FIT_H

#include <stddef.h>
#include <stdint.h>

/* Columns of the model, and the pixels' own values; design_matrix.py has the same names. */
enum {
    BLACK, CONTRAST, RIGHT, DOWN, TURN, GROW, BLUR, GROUND, ANISOTROPY_X, ANISOTROPY_Y, LIGHT_X, LIGHT_Y,
    KEYSTONE_X, KEYSTONE_Y, TONE, PIXEL, COLUMNS, UNKNOWNS = PIXEL
};

enum { MAX_CELLS = 20 };

/* Negative results of the functions. */
enum { FIT_INVALID_SIZE = -4, FIT_NO_MEMORY = -5 };

typedef struct { double re, im; } Complex;

/* Geometry and appearance of a marker; vision/native/library.py has the same fields. */
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
} Marker;

/* Pixels of markers, and the model's columns at them: 0 for pixels that are not used. */
typedef struct {
    const int64_t *bounds;          /* (count + 1,) */
    const float *places;            /* (rows, 2), x and y */
    const int32_t *pixels;          /* (rows, 2), v and u */
    float *columns;                 /* (rows, 16) */
    int64_t count, rows;
} MarkerRows;

/* Image and markers: the arguments of both functions that fill in columns. */
typedef struct {
    const uint8_t *image;           /* (height, width) */
    const Marker *markers;          /* (count,) */
    const float *cells;             /* (count, n + 2, n + 2), 1 where black, 0 where white and on the ground around */
    int64_t height, width;
    int32_t n;                      /* cells along a side */
    float texture_square;           /* variance of the ground's texture over that of the noise */
} Scene;

int64_t count_pixels(const Marker *markers, int64_t count, int64_t height, int64_t width);
int64_t list_pixels(const Marker *markers, int64_t count, int64_t height, int64_t width, int64_t *bounds, float *places,
                    int32_t *pixels, int64_t room);
int are_bounds_valid(const MarkerRows *given);
int32_t fill_round(const Scene *scene, const MarkerRows *given);
int32_t fill_elliptic(const Scene *scene, const MarkerRows *given, const double *blurs, float *bends);

int32_t gram_matrices(const MarkerRows *given, float *grams);
int32_t residuals(const MarkerRows *given, const float *solutions, float *left);
int32_t add_over_cells(const MarkerRows *given, const float *solutions, int32_t n, double *sums, double *used,
                       double *read, double *peaks);
int32_t add_over_boxes(const MarkerRows *given, const int64_t *picked, int64_t picked_count, const float *solutions,
                       const float *influences, int32_t quantities, int32_t box_px, double *small, double *large,
                       int64_t *boxes);

int32_t count_second_differences(const uint8_t *image, int64_t height, int64_t width, int32_t darkest,
                                 int32_t brightest, int64_t *counts);

int32_t hold_unknowns(double *values, double *inverse_normals, double *squares, int64_t count, int32_t first,
                      int32_t last, const double *at, const double *variances);
int32_t fit_plane(const Complex *points, const Complex *anisotropies, const double *variances, int64_t count,
                  const double limits[4], int32_t max_rounds, Complex plane[2], Complex covariance[4]);

#endif
