/* Discs. Their edge counts as straight, moved inwards by σ² / 2R for its curvature, which preserves the area: exact for
 * discs much larger than the blur. Shape coordinates are those in which the disc has radius 1. */
#include "render.h"

#include <math.h>

/* Least distance of a pixel from the centre, in radii. Chosen: at the centre the outward direction is undefined. */
static const double MIN_RADIUS = 1e-6;

/* Least variance of the blur along the radius, in squared radii. Chosen: avoids a division by zero at the centre. */
static const double MIN_VARIANCE = 1e-12;

/* Compute F and A of a disc. Along the unit vector (x, y) / r the blur's variance is that of (x / s_x, y / s_y), whose
 * axes have the cosine ρ: ((x/s_x)² + (y/s_y)² + 2 ρ (x/s_x) (y/s_y)) / r². */
static void cover_disc(const Run *run, const Places *places, const EdgeSpread *spread, const float *levels,
                       int32_t cells, float light[LANES], float covered[LANES]) {
    (void)cells;
    const float *restrict table = spread->table + (ptrdiff_t)run->direction_x * spread->samples;
    const double half = spread->samples / 2, per_sigma = (half - 1) / spread->reach, reach = spread->reach;
    for (int i = 0; i < LANES; i++) {
        const double x = places->x[i], y = places->y[i], far = sqrt(x * x + y * y);
        const double radius = far > MIN_RADIUS ? far : MIN_RADIUS;
        const double across_x = x / places->sharp_x[i], across_y = y / places->sharp_y[i];
        const double square = across_x * across_x + across_y * across_y + 2 * places->cosine[i] * across_x * across_y;
        const double sigma = sqrt(square > MIN_VARIANCE ? square : MIN_VARIANCE) / radius;
        const double distance = clamped((1 - radius) / sigma - sigma / 2, -reach, reach);
        covered[i] = table[(int32_t)(distance * per_sigma + (half + 0.5))];
        light[i] = levels[0] * covered[i];
    }
}

/* Draw discs of grey levels (count,). */
int32_t draw_discs(const Canvas *canvas, const Shapes *shapes, const EdgeSpread *spread, const float *levels) {
    return draw_shapes(canvas, shapes, spread, levels, 0, 1, cover_disc);
}
