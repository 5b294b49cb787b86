/* Drawing of the ground and of flat shapes on it: grids of grey cells, such as marker cards, and discs.
 *
 * Shapes are drawn one after another, each over those before it:
 *   1. outlines.c  the rows of pixels within a margin of a shape's outline; the loop over shapes and rows
 *   2. places.c    the place of each pixel in the shape, and the sharpness of edges there
 *   3. lattices.c, discs.c  light F from the shape, and the share A of the pixel that it covers
 *   4. outlines.c  the canvas becomes F + (1 - A) canvas
 * ground.c samples the texture of the ground.
 *
 * A pixel receives light over its square, blurred by the lens. S(d) is the share of light from the far side of an edge
 * at a signed distance d, in standard deviations σ of both; render/edge.py tabulates it. A shape maps its coordinates
 * (x, y) to pixels by a homography. Lens and rolling shutter only change the place of a pixel, and thereby its distance
 * to an edge.
 *
 * Pixels are computed in groups of LANES, by loops of a constant length that the compiler vectorizes. Each lane has its
 * own sums, so that all builds give equal bytes. Planes are row-major. No function allocates memory.
 */
#ifndef SKYHERD_RENDER_H
#define SKYHERD_RENDER_H

#include <stddef.h>
#include <stdint.h>

enum { LANES = 16, MAX_SIDE_PX = 1 << 20, MAX_PIXELS = 1 << 30, MAX_SHAPES = 1 << 24, MAX_CORNERS = 16, MAX_CELLS = 62 };

/* Negative results of the public functions. */
enum { INVALID_CANVAS = -1, INVALID_SHAPES = -2, INVALID_SPREAD = -3, INVALID_CELLS = -4, INVALID_TEXTURE = -5 };

/* An image to draw on: either grey levels of 8 bits or light, (height, width); the other pointer is NULL.
 *
 * `lens` is NULL without distortion, or has six planes: the displacement to the undistorted pixel along u and v, and
 * the derivatives du/du, du/dv, dv/du, dv/dv of the undistorted by the distorted position. */
typedef struct {
    int32_t width, height;
    uint8_t *image;
    float *light;
    const float *lens;
    const double *row_times; /* (height,) exposure of each row: -1, 0, 1 at the first, middle and last instant */
} Canvas;

/* Flat shapes: outlines (count, corners, 2), px, and homographies (instants, count, 3, 3) from undistorted pixels to
 * shape coordinates. With a rolling shutter there are three instants, which a parabola interpolates. */
typedef struct {
    int32_t count, corners, instants;
    const double *outlines_px;
    const double *matrices;
    double margin_px; /* distance beyond the outline at which a pixel may still be affected */
} Shapes;

/* Blur of lens and pixel, and limits; render/edge.py states the reason of each value. */
typedef struct {
    double sigma_px, kurtosis; /* σ; fourth cumulant of the pixel over σ⁴ */
    double reach, felt;        /* half the length of the table; distance beyond which a line is ignored; σ */
    double square, boxy, slanted;
    const float *table; /* (directions, samples) of S, evenly in cos 4α and in -reach..reach */
    int32_t directions, samples;
} EdgeSpread;

/* Pixels first_u..end_u-1 of row v that a shape may affect, and the geometry of the first one. */
typedef struct {
    double matrix[9]; /* from undistorted pixels to the shape, at the time of the row */
    int32_t v, first_u, end_u;
    int is_affine;                 /* the map is affine along the row: sharpness is constant */
    double x, y, step_x, step_y;   /* place of the first pixel, and its change along an affine row */
    double sharp_x, sharp_y, cosine;
    int32_t direction_x, direction_y; /* rows of the table for lines of constant x and constant y */
    double slopes[4];              /* ∂x/∂u, ∂x/∂v, ∂y/∂u, ∂y/∂v, up to a factor */
} Run;

/* Places of LANES pixels in a shape. */
typedef struct {
    double x[LANES], y[LANES];
    float sharp_x[LANES], sharp_y[LANES]; /* one unit of x and of y, in σ */
    float cosine[LANES];                  /* of the angle between the gradients of x and y */
    int32_t is_seen[LANES];               /* 1 for pixels of the run on the camera's side of the horizon */
} Places;

/* Function of one kind of shape: F and A of LANES pixels. `levels` are those of the shape. */
typedef void Cover(const Run *run, const Places *places, const EdgeSpread *spread, const float *levels, int32_t cells,
                   float light[LANES], float covered[LANES]);

/* Return x within low..high; NaN becomes low. Two selections are two instructions, nested ones are branches. */
static inline double clamped(double x, double low, double high) {
    const double above = x > low ? x : low;
    return above < high ? above : high;
}

static inline float clamped_float(float x, float low, float high) {
    const float above = x > low ? x : low;
    return above < high ? above : high;
}

/* places.c */
void matrix_of_row(const double *matrices, int32_t count, int32_t instants, int32_t shape, double row_time,
                   double matrix[9]);
void begin_run(const Canvas *canvas, const EdgeSpread *spread, int32_t v, int32_t first_u, int32_t end_u, Run *run);
void locate(const Canvas *canvas, const EdgeSpread *spread, const Run *run, int32_t u, Places *places);

/* outlines.c */
int is_valid_canvas(const Canvas *canvas);
int32_t draw_shapes(const Canvas *canvas, const Shapes *shapes, const EdgeSpread *spread, const float *levels,
                    int32_t cells, int32_t levels_per_shape, Cover *cover);

/* The library's functions, called from Python. They return 0 or an error. */
int32_t draw_lattices(const Canvas *canvas, const Shapes *shapes, const EdgeSpread *spread, const float *levels,
                      int32_t cells);
int32_t draw_discs(const Canvas *canvas, const Shapes *shapes, const EdgeSpread *spread, const float *levels);
int32_t draw_ground(const Canvas *canvas, const double *matrices, int32_t instants, const uint8_t *texture,
                    int32_t samples, int32_t stride);

#endif
