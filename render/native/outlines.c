/* The pixels within a margin of a shape's outline, and the loop over shapes and rows.
 *
 * An outline is convex. Its pixels lie behind each edge, moved outwards by the margin: n_u u + n_v v <= d + margin,
 * with unit normals n.
 */
#include "render.h"

#include <math.h>

/* Least part of a normal along a row. Chosen: such an edge bounds the row at 1e9 px, beyond any image. */
static const double TINY = 1e-9;

/* Greatest length of the table, σ. Derived: densities at corners then have exponents above -80 (lattices.c). */
static const double MAX_REACH = 4;

/* An edge bounds the columns of row v by u <= cut - slope v, or by u >= if its normal points to the left. */
typedef struct { double cut, slope; int is_left; } Edge;

int is_valid_canvas(const Canvas *canvas) {
    return canvas && canvas->width > 0 && canvas->height > 0 && canvas->width <= MAX_SIDE_PX &&
           canvas->height <= MAX_SIDE_PX && (int64_t)canvas->width * canvas->height <= MAX_PIXELS &&
           !canvas->image != !canvas->light && canvas->row_times;
}

static int is_valid_spread(const EdgeSpread *spread) {
    return spread && spread->table && spread->sigma_px > 0 && spread->felt > 0 &&
           spread->felt <= spread->reach && spread->reach <= MAX_REACH && spread->directions > 0 &&
           spread->directions <= 1 << 10 && spread->samples >= 4 && spread->samples <= 1 << 20;
}

static int is_valid_shapes(const Shapes *shapes) {
    return shapes && shapes->count >= 0 && shapes->count <= MAX_SHAPES && shapes->corners >= 3 &&
           shapes->corners <= MAX_CORNERS && (shapes->instants == 1 || shapes->instants == 3) &&
           shapes->margin_px >= 0 && ((shapes->outlines_px && shapes->matrices) || !shapes->count);
}

/* Write the first row that an outline affects and the one after the last. */
static void rows_of(const double *outline_px, int32_t corners, double margin_px, int32_t height, int32_t *first,
                    int32_t *end) {
    double low = INFINITY, high = -INFINITY;
    for (int32_t corner = 0; corner < corners; corner++) {
        const double v = outline_px[2 * corner + 1];
        low = v < low ? v : low;
        high = v > high ? v : high;
    }
    *first = (int32_t)clamped(ceil(low - margin_px), 0, height);
    *end = (int32_t)clamped(floor(high + margin_px) + 1, 0, height);
}

/* Compute the moved edges of an outline, in either sense. */
static void bound_edges(const double *outline_px, int32_t corners, double margin_px, Edge *edges) {
    double area = 0;
    for (int32_t corner = 0; corner < corners; corner++) {
        const double *at = outline_px + 2 * corner, *after = outline_px + 2 * ((corner + 1) % corners);
        area += at[0] * after[1] - at[1] * after[0];
    }
    for (int32_t corner = 0; corner < corners; corner++) {
        const double *at = outline_px + 2 * corner, *after = outline_px + 2 * ((corner + 1) % corners);
        const double along_u = after[0] - at[0], along_v = after[1] - at[1];
        const double length = sqrt(along_u * along_u + along_v * along_v) + TINY;
        const double sense = area < 0 ? -1 / length : 1 / length;
        double normal_u = sense * along_v;
        const double normal_v = -sense * along_u;
        if (fabs(normal_u) < TINY) normal_u = TINY;
        edges[corner] = (Edge){(normal_u * at[0] + normal_v * at[1] + margin_px) / normal_u, normal_v / normal_u,
                               normal_u < 0};
    }
}

/* Write the first column of row v within all edges and the one after the last; equal ones if there is none. */
static void columns_of(const Edge *edges, int32_t corners, int32_t v, int32_t width, int32_t *first, int32_t *end) {
    double low = 0, high = width - 1;
    for (int32_t edge = 0; edge < corners; edge++) {
        const double bound = edges[edge].cut - edges[edge].slope * v;
        if (edges[edge].is_left) low = bound > low ? bound : low;
        else high = bound < high ? bound : high;
    }
    const int is_empty = !(low <= high);
    *first = is_empty ? 0 : (int32_t)ceil(low);
    *end = is_empty ? 0 : (int32_t)floor(high) + 1;
}

/* Write F + (1 - A) background over LANES pixels of light, where they are seen. */
static void blend_light(float *restrict canvas, const int32_t is_seen[restrict LANES], const float light[restrict LANES],
                        const float covered[restrict LANES]) {
    for (int i = 0; i < LANES; i++) {
        const float drawn = (1 - covered[i]) * canvas[i] + light[i];
        canvas[i] = is_seen[i] ? drawn : canvas[i];
    }
}

/* The same over grey levels of 8 bits, rounded. */
static void blend_image(uint8_t *restrict canvas, const int32_t is_seen[restrict LANES],
                        const float light[restrict LANES], const float covered[restrict LANES]) {
    for (int i = 0; i < LANES; i++) {
        const float before = canvas[i], drawn = (1 - covered[i]) * before + light[i];
        canvas[i] = (uint8_t)(int32_t)clamped_float(rintf(is_seen[i] ? drawn : before), 0, 255);
    }
}

/* Blend `count` pixels of the canvas that begin at `at`. */
static void blend(const Canvas *canvas, ptrdiff_t at, int32_t count, const int32_t is_seen[LANES],
                  const float light[LANES], const float covered[LANES]) {
    uint8_t levels[LANES] = {0};
    float lights[LANES] = {0};
    if (count == LANES && canvas->light) blend_light(canvas->light + at, is_seen, light, covered);
    else if (count == LANES) blend_image(canvas->image + at, is_seen, light, covered);
    else if (canvas->light) {
        for (int32_t i = 0; i < count; i++) lights[i] = canvas->light[at + i];
        blend_light(lights, is_seen, light, covered);
        for (int32_t i = 0; i < count; i++) canvas->light[at + i] = lights[i];
    } else {
        for (int32_t i = 0; i < count; i++) levels[i] = canvas->image[at + i];
        blend_image(levels, is_seen, light, covered);
        for (int32_t i = 0; i < count; i++) canvas->image[at + i] = levels[i];
    }
}

static void draw_run(const Canvas *canvas, const EdgeSpread *spread, const Run *run, const float *levels,
                     int32_t cells, Cover *cover) {
    Places places;
    float light[LANES], covered[LANES];
    for (int32_t u = run->first_u; u < run->end_u; u += LANES) {
        const int32_t count = run->end_u - u < LANES ? run->end_u - u : LANES;
        locate(canvas, spread, run, u, &places);
        cover(run, &places, spread, levels, cells, light, covered);
        blend(canvas, (ptrdiff_t)run->v * canvas->width + u, count, places.is_seen, light, covered);
    }
}

/* Draw shapes in their order. `levels` has `levels_per_shape` values of each. */
int32_t draw_shapes(const Canvas *canvas, const Shapes *shapes, const EdgeSpread *spread, const float *levels,
                    int32_t cells, int32_t levels_per_shape, Cover *cover) {
    if (!is_valid_canvas(canvas)) return INVALID_CANVAS;
    if (!is_valid_shapes(shapes) || (shapes->count && !levels)) return INVALID_SHAPES;
    if (!is_valid_spread(spread)) return INVALID_SPREAD;
    const int32_t corners = shapes->corners;
    Edge edges[MAX_CORNERS];
    Run run;
    for (int32_t shape = 0; shape < shapes->count; shape++) {
        const double *outline_px = shapes->outlines_px + 2 * (ptrdiff_t)corners * shape;
        int32_t v, end, first_u, end_u;
        rows_of(outline_px, corners, shapes->margin_px, canvas->height, &v, &end);
        bound_edges(outline_px, corners, shapes->margin_px, edges);
        for (; v < end; v++) {
            columns_of(edges, corners, v, canvas->width, &first_u, &end_u);
            if (first_u >= end_u) continue;
            matrix_of_row(shapes->matrices, shapes->count, shapes->instants, shape, canvas->row_times[v], run.matrix);
            begin_run(canvas, spread, v, first_u, end_u, &run);
            draw_run(canvas, spread, &run, levels + (ptrdiff_t)levels_per_shape * shape, cells, cover);
        }
    }
    return 0;
}
