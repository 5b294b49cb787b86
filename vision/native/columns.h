/* Marker under a Gaussian blur at some pixels at a time, and the columns of the model there.
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

#if defined(__AVX512F__)
#include <immintrin.h>
#endif

enum { MAX_EDGES = MAX_CELLS + 1, BEYOND = 5, ROWS = MAX_CELLS + 2 * BEYOND, MAX_ORDERS = 5 };

/* Edges further away than this many standard deviations count as passed or as not reached. Chosen: Φ is within 3e-7 of its
 * limits there, and its second derivative within 8e-6. */
static const float REACH_SIGMAS = 5.0f;

/* Rows of a marker's cells as bits, from BEYOND rows above it to BEYOND below: bit c + BEYOND of row r + BEYOND is cell
 * (r, c), 1 where black. There is room for two vectors of the widest build. */
enum { ROOM = 32 };
_Static_assert(ROWS <= ROOM, "all rows are in two vectors");
typedef struct { int32_t rows[ROOM]; } CellBits;

INLINE CellBits bits_of(const float *cells, int32_t n) {
    CellBits bits = {{0}};
    for (int32_t r = 0; r < n; r++)
        for (int32_t c = 0; c < n; c++)
            if (cells[(r + 1) * (n + 2) + c + 1] > 0.5f) bits.rows[r + BEYOND] |= 1 << (c + BEYOND);
    return bits;
}

/* Return the ground around a marker without a card as cells: 1 outside of the marker's border, 0 in it. */
INLINE CellBits ground_bits(int32_t n) {
    CellBits bits = {{0}};
    const int32_t all_cells = (1 << (n + 2 * BEYOND)) - 1, inside = ((1 << n) - 1) << BEYOND;
    for (int32_t r = 0; r < n + 2 * BEYOND; r++)
        bits.rows[r] = r >= BEYOND && r < n + BEYOND ? all_cells & ~inside : all_cells;
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

/* Return the rows of the given numbers. */
INLINE Ints rows_at(const CellBits *bits, Ints numbers) {
#if defined(__AVX512F__)
    Ints halves[ROOM / LANES];
    memcpy(halves, bits->rows, sizeof halves);
    return (Ints)_mm512_permutex2var_epi32((__m512i)halves[0], (__m512i)numbers, (__m512i)halves[1]);
#else
    Ints rows;
    for (int i = 0; i < LANES; i++) rows[i] = bits->rows[numbers[i]];
    return rows;
#endif
}

/* Return one row of the cells about each pixel as bits, from the cell before its first edge on. */
INLINE Ints cells_of(const CellBits *bits, const Edges *across, const Edges *down, int row) {
    return rows_at(bits, down->first + (BEYOND - 1 + row)) >> (across->first + (BEYOND - 1));
}

/* Ground beyond the card that pixels hold, as a share, and the weights that it leaves: 1 / sqrt(1 + t² g²). */
typedef struct { Floats ground, weight; } Ground;

INLINE Ground weighted_ground(Floats share, float texture_square) {
    return (Ground){share, 1.0f / square_root(1.0f + texture_square * share * share)};
}

/* Return the ground at pixels; x_rate and y_rate are standard deviations of the blur to a side. */
INLINE Ground ground_at(Floats x, Floats y, float half_card, Floats x_rate, Floats y_rate, float texture_square) {
    const Floats far_x = (half_card - absolute(x)) * x_rate, far_y = (half_card - absolute(y)) * y_rate;
    const Floats ground = 1.0f - step(far_x, bell(far_x)) * step(far_y, bell(far_y));
    const Ints within = (far_x >= REACH_SIGMAS) & (far_y >= REACH_SIGMAS);
    return weighted_ground(choose(within, (Floats){0}, ground), texture_square);
}

/* What a pixel shows: its level, the level's slopes times the weight, its change with log σ, and the ground.
 *
 * The level is T, and T + ρ G around a marker without a card, with G the share of the ground and ρ its level. */
typedef struct { Floats level, slope_x, slope_y, log_blur; Ground ground; } Shown;

typedef uint8_t Bytes __attribute__((vector_size(LANES)));

/* Part of a block of pixels: places, lines and columns of the image, grey levels, which of them are the marker's own, and
 * where the first column of the model is written. */
typedef struct { Floats x, y, grey; Ints v, u, within; int64_t columns; } Part;

/* Return the grey levels of LANES pixels, which mostly lie side by side. */
INLINE Floats grey_levels(const Scene *scene, const int32_t *pixels) {
    const int32_t *u = pixels + BLOCK_PX, last = LANES - 1;
    Floats grey;
    if (pixels[0] == pixels[last] && u[last] - u[0] == last) {
        Bytes line;
        memcpy(&line, scene->image + pixels[0] * scene->width + u[0], sizeof line);
        return __builtin_convertvector(line, Floats);
    }
    for (int i = 0; i < LANES; i++) grey[i] = scene->image[pixels[i] * scene->width + u[i]];
    return grey;
}

INLINE Part part_at(const Scene *scene, const MarkerBlocks *given, int64_t k, int64_t block, int32_t first) {
    const int64_t rest = given->counts[k] - (block - given->bounds[k]) * BLOCK_PX - first;
    const float *places = given->places + block * (2 * BLOCK_PX) + first;
    const int32_t *pixels = given->pixels + block * (2 * BLOCK_PX) + first;
    Part part = {.x = load(places), .y = load(places + BLOCK_PX), .columns = block * (COLUMNS * BLOCK_PX) + first};
    memcpy(&part.v, pixels, sizeof part.v);
    memcpy(&part.u, pixels + BLOCK_PX, sizeof part.u);
    part.grey = grey_levels(scene, pixels);
    for (int i = 0; i < LANES; i++) part.within[i] = i < rest ? -1 : 0;
    return part;
}

/* Write the columns of the model at a part of a block. */
INLINE void write_columns(const Shown *shown, const Part *part, const Marker *marker, float *written) {
    const Floats x = part->x, y = part->y, white = shown->level - (float)marker->ground_level * shown->ground.ground;
    const Floats weight = shown->ground.weight, slope_x = shown->slope_x, slope_y = shown->slope_y;
    const Floats level = shown->level * weight, grow = -(x * slope_x + y * slope_y);
    const Floats light = (float)marker->black_ratio * weight + level;
    Floats columns[COLUMNS];
    columns[BLACK] = weight;
    columns[CONTRAST] = white * weight;
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
    columns[TONE] = level * (1.0f - shown->level);
    columns[PIXEL] = (part->grey - (float)MIDDLE_GREY) * weight;
    for (int c = 0; c < COLUMNS; c++)
        store(choose(part->within, columns[c], (Floats){0}), written + part->columns + c * BLOCK_PX);
}

/* Return whether the sizes are valid, and all pixels are within the image. */
INLINE int are_valid(const Scene *scene, const MarkerBlocks *given) {
    if (scene->n <= 0 || scene->n > MAX_CELLS || !are_bounds_valid(given)) return 0;
    int outside = 0;
    for (int64_t block = given->bounds[0]; block < given->bounds[given->count]; block++) {
        const int32_t *v = given->pixels + block * (2 * BLOCK_PX), *u = v + BLOCK_PX;
        for (int i = 0; i < BLOCK_PX; i++)
            outside |= (v[i] < 0) | (v[i] >= scene->height) | (u[i] < 0) | (u[i] >= scene->width);
    }
    return !outside;
}

#endif
