/* Marker under a Gaussian blur at eight pixels at a time, and the columns of the model there.
 *
 * With black as 0 and white as 1, a marker on an endless white ground under a Gaussian of standard deviation σ separates:
 *
 *     T(y, x) = 1 - Σ_r Σ_c E_r(y) B_rc E_c(x),   E_c(x) = Φ((x - e_c) / σ) - Φ((x - e_{c+1}) / σ),
 *
 * with B_rc = 1 where the cell is black and e the cells' edges. Summed by edges instead of cells, a row of cells is
 * Σ_c B_c E_c(x) = B_f + Σ_e (B_e - B_{e-1}) Φ((x - e) / σ), in which only edges within REACH_SIGMAS of x count: those
 * further left are passed, up to the cell f, and those further right are not reached.
 */
#ifndef SKYHERD_COLUMNS_H
#define SKYHERD_COLUMNS_H

#include "fit.h"
#include "floats.h"

#include <string.h>

enum { MAX_EDGES = MAX_CELLS + 1, BEYOND = 5, ROWS = MAX_CELLS + 2 * BEYOND, MAX_ORDERS = 5 };

/* Edges further away than this many standard deviations count as passed or as not reached. Chosen: Φ is within 3e-7 of its
 * limits there, and its second derivative within 8e-6. */
static const float REACH_SIGMAS = 5.0f;

/* Rows of a marker's cells as bits, from BEYOND rows above it to BEYOND below: bit c + BEYOND of row r + BEYOND is cell
 * (r, c), 1 where black. */
typedef struct { int32_t rows[ROWS]; } CellBits;

INLINE CellBits bits_of(const float *cells, int32_t n) {
    CellBits bits = {{0}};
    for (int32_t r = 0; r < n; r++)
        for (int32_t c = 0; c < n; c++)
            if (cells[(r + 1) * (n + 2) + c + 1] > 0.5f) bits.rows[r + BEYOND] |= 1 << (c + BEYOND);
    return bits;
}

/* Edges along one axis about the pixels: the first one, and Φ and its derivatives, times powers of σ, at all of them. */
typedef struct { Ints first; Floats orders[MAX_ORDERS][MAX_EDGES]; } Edges;

/* Compute the edges along one axis.
 *
 * count: of edges, 2, 4, 6 or 8 about the position, or all n + 1 of them.
 * orders: 3 or 5 of Φ and its derivatives.
 * position: in cells, from the first edge of the marker; per_cell: standard deviations of the blur to a cell. */
INLINE void compute_edges(int count, int is_all, int orders, int32_t n, Floats position, Floats per_cell, Edges *edges) {
    const Floats inside = smaller(larger(position, all(-1.0f)), all((float)n));
    const Ints cell = whole(inside) + (number(whole(inside)) > inside); /* the floor: comparisons are -1 */
    edges->first = is_all ? (Ints){0} : cell - (count / 2 - 1);
    for (int e = 0; e < count; e++) {
        const Floats z = (position - number(edges->first + e)) * per_cell, density = bell(z);
        edges->orders[0][e] = step(z, density);
        edges->orders[1][e] = density;
        edges->orders[2][e] = -z * density;
        if (orders > 3) {
            edges->orders[3][e] = (z * z - 1.0f) * density;
            edges->orders[4][e] = z * (3.0f - z * z) * density;
        }
    }
}

/* Add up one row of cells: Σ_c B_c E_c and its derivatives, times powers of σ_x. */
INLINE void sum_row(int count, int orders, Ints cells, const Edges *across, Floats sums[MAX_ORDERS]) {
    Floats before = number(cells & 1);
    sums[0] = before;
    for (int k = 1; k < orders; k++) sums[k] = (Floats){0};
    for (int e = 0; e < count; e++) {
        const Floats next = number((cells >> (e + 1)) & 1), change = next - before;
        for (int k = 0; k < orders; k++) sums[k] += change * across->orders[k][e];
        before = next;
    }
}

/* Return one row of the cells about each pixel as bits, from the cell before its first edge on. */
INLINE Ints cells_of(const CellBits *bits, const Edges *across, const Edges *down, int row) {
    Ints cells = {0};
    for (int i = 0; i < LANES; i++)
        cells[i] = bits->rows[down->first[i] - 1 + BEYOND + row] >> (across->first[i] - 1 + BEYOND);
    return cells;
}

/* Ground beyond the card that pixels hold, as a share, and the weights that it leaves: 1 / sqrt(1 + t² g²). */
typedef struct { Floats ground, weight; } Ground;

/* Return the ground at pixels; x_rate and y_rate are standard deviations of the blur to a side. */
INLINE Ground ground_at(Floats x, Floats y, float half_card, Floats x_rate, Floats y_rate, float texture_square) {
    const Floats far_x = (half_card - absolute(x)) * x_rate, far_y = (half_card - absolute(y)) * y_rate;
    const Floats ground = 1.0f - step(far_x, bell(far_x)) * step(far_y, bell(far_y));
    const Ints within = (far_x >= REACH_SIGMAS) & (far_y >= REACH_SIGMAS);
    const Floats share = choose(within, (Floats){0}, ground);
    return (Ground){share, 1.0f / square_root(1.0f + texture_square * share * share)};
}

/* What a pixel shows: T, its slopes times the weight, T_log σ, and the ground. */
typedef struct { Floats white, slope_x, slope_y, log_blur; Ground ground; } Shown;

/* Write the columns of the model at `count` of eight pixels, each a row of 16 floats. */
INLINE void write_columns(const Shown *shown, Floats x, Floats y, float ratio, Floats grey, int count, float *rows) {
    const Floats weight = shown->ground.weight, slope_x = shown->slope_x, slope_y = shown->slope_y;
    const Floats contrast = shown->white * weight, grow = -(x * slope_x + y * slope_y);
    const Floats light = ratio * weight + contrast;
    Floats columns[COLUMNS];
    columns[BLACK] = weight;
    columns[CONTRAST] = contrast;
    columns[RIGHT] = -slope_x;
    columns[DOWN] = -slope_y;
    columns[TURN] = y * slope_x - x * slope_y;
    columns[GROW] = grow;
    columns[BLUR] = shown->log_blur * weight;
    columns[GROUND] = shown->ground.ground * weight;
    columns[ANISOTROPY_X] = y * slope_y - x * slope_x;
    columns[ANISOTROPY_Y] = -(y * slope_x + x * slope_y);
    columns[LIGHT_X] = x * light;
    columns[LIGHT_Y] = y * light;
    columns[KEYSTONE_X] = -grow * x;
    columns[KEYSTONE_Y] = -grow * y;
    columns[TONE] = contrast * (1.0f - shown->white);
    columns[PIXEL] = (grey - 128.0f) * weight;
    for (int i = 0; i < count; i++)
        for (int c = 0; c < COLUMNS; c++) rows[i * COLUMNS + c] = columns[c][i];
}

/* Eight pixels from row `row` on: places, grey levels, and how many there are; the rest repeats the last one. */
typedef struct { Floats x, y, grey; int32_t count, u[LANES], v[LANES]; } Block;

INLINE Block block_of(const Scene *scene, const MarkerRows *given, int64_t row, int64_t end) {
    Block block = {{0}, {0}, {0}, end - row < LANES ? (int32_t)(end - row) : LANES, {0}, {0}};
    for (int i = 0; i < LANES; i++) {
        const int64_t at = row + (i < block.count ? i : block.count - 1);
        block.x[i] = given->places[2 * at];
        block.y[i] = given->places[2 * at + 1];
        block.v[i] = given->pixels[2 * at];
        block.u[i] = given->pixels[2 * at + 1];
        block.grey[i] = scene->image[block.v[i] * scene->width + block.u[i]];
    }
    return block;
}

/* Return whether the sizes are valid, and all pixels are within the image. */
INLINE int are_valid(const Scene *scene, const MarkerRows *given) {
    if (scene->n <= 0 || scene->n > MAX_CELLS || !are_bounds_valid(given)) return 0;
    int outside = 0;
    for (int64_t row = given->bounds[0]; row < given->bounds[given->count]; row++) {
        const int64_t v = given->pixels[2 * row], u = given->pixels[2 * row + 1];
        outside |= (v < 0) | (v >= scene->height) | (u < 0) | (u >= scene->width);
    }
    return !outside;
}

#endif
