/* Products of the model's columns, and residuals: of each pixel, and summed over cells and over boxes of pixels. */
#include "fit.h"

#include <math.h>
#include <stdlib.h>

enum { BLOCK_FLOATS = COLUMNS * BLOCK_PX, BLOCKS_AT_ONCE = 32, QUARTERS = 4, MAX_QUANTITIES = 8 };

/* Return the sum of the model's columns at some pixels, times factors (15,). */
INLINE Floats model_at(const float *columns, const float *factors) {
    Floats even = {0}, odd = {0}; /* two sums, of which neither waits for the other */
    for (int i = 0; i + 1 < UNKNOWNS; i += 2) {
        even += factors[i] * load(columns + i * BLOCK_PX);
        odd += factors[i + 1] * load(columns + (i + 1) * BLOCK_PX);
    }
    return even + odd + factors[UNKNOWNS - 1] * load(columns + (UNKNOWNS - 1) * BLOCK_PX);
}

/* Return the columns of the pixels from place `at` on; places count from the first block, BLOCK_PX for each. */
INLINE const float *columns_at(const MarkerBlocks *given, int64_t at) {
    return given->columns + at / BLOCK_PX * BLOCK_FLOATS + at % BLOCK_PX;
}

/* Return pixels less the model at them, times the pixels' weights. */
INLINE Floats residuals_of(const float *columns, const float *solution) {
    return load(columns + PIXEL * BLOCK_PX) - model_at(columns, solution);
}

/* Columns whose products with as many others are summed at a time: so many sums stay in registers. */
enum { PARTS = BLOCK_PX / LANES, TILE = 4 / PARTS };

/* Add to `total` the products of TILE columns from `first` on with those from `second` on, over some blocks; of pairs of the
 * same columns only one. */
INLINE void add_products(int first, int second, int is_same, const float *columns, int64_t blocks,
                         Doubles total[COLUMNS][COLUMNS]) {
    Floats sums[TILE][TILE][PARTS] = {{{{0}}}};
    for (int64_t block = 0; block < blocks; block++, columns += BLOCK_FLOATS)
        for (int i = 0; i < TILE; i++)
            for (int j = is_same ? i : 0; j < TILE; j++)
                for (int part = 0; part < PARTS; part++)
                    sums[i][j][part] += load(columns + (first + i) * BLOCK_PX + part * LANES) *
                                        load(columns + (second + j) * BLOCK_PX + part * LANES);
    for (int i = 0; i < TILE; i++)
        for (int j = is_same ? i : 0; j < TILE; j++)
            for (int part = 0; part < PARTS; part++) add_in_double(sums[i][j][part], &total[first + i][second + j]);
}

/* Compute the products (count, 16, 16) of the columns of each marker. Some blocks are added up in single precision, lane by
 * lane, and their sums in double precision. */
int32_t gram_matrices(const MarkerBlocks *given, float *grams) {
    if (!are_bounds_valid(given)) return FIT_INVALID_SIZE;
    for (int64_t k = 0; k < given->count; k++, grams += COLUMNS * COLUMNS) {
        Doubles total[COLUMNS][COLUMNS] = {{{0}}};
        for (int64_t begin = given->bounds[k]; begin < given->bounds[k + 1]; begin += BLOCKS_AT_ONCE) {
            const int64_t rest = given->bounds[k + 1] - begin, blocks = rest < BLOCKS_AT_ONCE ? rest : BLOCKS_AT_ONCE;
            const float *columns = given->columns + begin * BLOCK_FLOATS;
            for (int i = 0; i < COLUMNS; i += TILE) {
                add_products(i, i, 1, columns, blocks, total);
                for (int j = i + TILE; j < COLUMNS; j += TILE) add_products(i, j, 0, columns, blocks, total);
            }
        }
        for (int i = 0; i < COLUMNS; i++)
            for (int j = i; j < COLUMNS; j++) grams[i * COLUMNS + j] = grams[j * COLUMNS + i] = (float)sum_of(total[i][j]);
    }
    return 0;
}

/* Compute the weighted residuals (blocks, BLOCK_PX), grey levels, of the model at solutions (count, 15). */
int32_t residuals(const MarkerBlocks *given, const float *solutions, float *left) {
    if (!are_bounds_valid(given)) return FIT_INVALID_SIZE;
    for (int64_t k = 0; k < given->count; k++)
        for (int64_t at = given->bounds[k] * BLOCK_PX; at < given->bounds[k + 1] * BLOCK_PX; at += LANES)
            store(residuals_of(columns_at(given, at), solutions + k * UNKNOWNS), left + at);
    return 0;
}

/* Sums over the cells of a marker, of every fourth pixel each, so that no addition waits for that of the pixel before:
 * residuals, pixels that have a weight, and all pixels. Behind the cells is a place for pixels beside the marker. */
enum { TURNS = 4, CELLS_AND_BESIDE = MAX_CELLS * MAX_CELLS + 1 };
typedef struct { double left; int32_t used, read; } CellSum;
typedef struct { CellSum of[CELLS_AND_BESIDE][TURNS]; int32_t n; } CellSums;

/* Add residuals to the cells that the first `count` of their pixels lie in. */
INLINE void add_to_cells(const float *places, const float *weights, Floats left, int64_t count, CellSums *sums) {
    const int32_t n = sums->n;
    const Floats half = all((float)n / 2);
    const Floats across = load(places) * (float)n + half, down = load(places + BLOCK_PX) * (float)n + half;
    const Ints column = whole(across), row = whole(down);
    const Ints inside = (across >= 0) & (down >= 0) & (column < n) & (row < n);
    const Ints cell = ((row * n + column) & inside) | (n * n & ~inside);
    for (int64_t i = 0; i < count; i++) {
        CellSum *sum = &sums->of[cell[i]][i % TURNS];
        sum->left += (double)left[i];
        sum->used += weights[i] > 0;
        sum->read += 1;
    }
}

static CellSum sum_of_turns(const CellSum *of) {
    return (CellSum){(of[0].left + of[1].left) + (of[2].left + of[3].left), of[0].used + of[1].used + of[2].used + of[3].used,
                     of[0].read + of[1].read + of[2].read + of[3].read};
}

/* Add up residuals over the cells of each marker.
 *
 * sums, used and read (count, n, n) are the residuals over each cell, the number of its pixels that have a weight, and that
 * of all its pixels. peaks (count,) are the largest absolute residuals of a pixel, besides (count,) the mean residuals of the
 * pixels beside the markers. Returns 0 or an error. */
int32_t add_over_cells(const MarkerBlocks *given, const float *solutions, int32_t n, double *sums, double *used,
                       double *read, double *peaks, double *besides) {
    if (n <= 0 || n > MAX_CELLS || !are_bounds_valid(given)) return FIT_INVALID_SIZE;
    CellSums own;
    own.n = n;
    for (int64_t k = 0; k < given->count; k++) {
        Floats largest = {0};
        const int64_t begin = given->bounds[k] * BLOCK_PX, end = begin + given->counts[k];
        memset(own.of, 0, ((size_t)n * (size_t)n + 1) * sizeof own.of[0]);
        for (int64_t at = begin; at < end; at += LANES) {
            const float *columns = columns_at(given, at), *places = given->places + at / BLOCK_PX * (2 * BLOCK_PX);
            const Floats left = residuals_of(columns, solutions + k * UNKNOWNS);
            largest = larger(largest, absolute(left));
            add_to_cells(places + at % BLOCK_PX, columns + BLACK * BLOCK_PX, left, end - at < LANES ? end - at : LANES,
                         &own);
        }
        for (int32_t cell = 0; cell < n * n; cell++, sums++, used++, read++) {
            const CellSum sum = sum_of_turns(own.of[cell]);
            *sums = sum.left, *used = sum.used, *read = sum.read;
        }
        const CellSum beside = sum_of_turns(own.of[n * n]);
        besides[k] = beside.left / (beside.used > 1 ? beside.used : 1);
        float peak = 0;
        for (int i = 0; i < LANES; i++) peak = largest[i] > peak ? largest[i] : peak;
        peaks[k] = (double)peak;
    }
    return 0;
}

/* Return the texture of the ground around a marker without a card, grey levels, by the residuals of a solution (15,).
 *
 * A pixel of which the ground has the share G varies by noise² + (texture G)². Pixels count of which it has most. */
double ground_texture(const MarkerBlocks *given, const float *solution, double noise) {
    double excess = 0, shares = 0;
    for (int64_t at = 0; at < given->counts[0]; at += LANES) {
        const float *columns = columns_at(given, at), *weights = columns + BLACK * BLOCK_PX;
        const Floats left = residuals_of(columns, solution), ground = load(columns + GROUND * BLOCK_PX);
        for (int i = 0; i < LANES; i++) {
            if (!(weights[i] > 0) || !(ground[i] > 0.5f * weights[i])) continue;
            const double share = (double)ground[i] / (double)weights[i], own = (double)left[i] / (double)weights[i];
            excess += own * own - noise * noise;
            shares += share * share;
        }
    }
    return shares > 0 && excess > 0 ? sqrt(excess / shares) : 0.0;
}

/* Lines and columns of boxes that a marker's pixels lie in. */
typedef struct { int32_t top, left, bottom, right; } Extent;

static Extent extent_of(const MarkerBlocks *given, int64_t k, int32_t box_px) {
    Extent px = {INT32_MAX, INT32_MAX, 0, 0};
    for (int64_t block = given->bounds[k]; block < given->bounds[k + 1]; block++) {
        const float *weights = given->columns + block * BLOCK_FLOATS + BLACK * BLOCK_PX;
        const int32_t *v = given->pixels + block * (2 * BLOCK_PX), *u = v + BLOCK_PX;
        for (int i = 0; i < BLOCK_PX; i++) {
            if (!(weights[i] > 0)) continue;
            px.top = v[i] < px.top ? v[i] : px.top;
            px.bottom = v[i] > px.bottom ? v[i] : px.bottom;
            px.left = u[i] < px.left ? u[i] : px.left;
            px.right = u[i] > px.right ? u[i] : px.right;
        }
    }
    if (px.top > px.bottom) return px; /* no pixel is used */
    return (Extent){px.top / box_px, px.left / box_px, px.bottom / box_px, px.right / box_px};
}

/* A small box along one axis: its number, and its first pixel. */
typedef struct { int32_t number, first; } Span;

/* Return the small box of a line or column, which is mostly that of the pixel before: a division takes long. */
static inline Span span_of(Span before, int32_t at, int32_t box_px) {
    if (at >= before.first && at < before.first + box_px) return before;
    return (Span){at / box_px, at / box_px * box_px};
}

/* Sums of one large box: of each quantity over each quarter, and whether it has a pixel. */
static inline double *box_at(double *boxes, int64_t index, int32_t quantities) {
    return boxes + index * (QUARTERS * quantities + 1);
}

/* Add influences times residuals of a marker's pixels to boxes. */
static void add_to_boxes(const MarkerBlocks *given, int64_t k, const float *solution, const float *influences,
                         int32_t quantities, int32_t box_px, Extent extent, double *boxes) {
    const int64_t across = (extent.right - extent.left) / 2 + 1;
    Span line = {0, 0}, column = {0, 0};
    for (int64_t at = given->bounds[k] * BLOCK_PX; at < given->bounds[k + 1] * BLOCK_PX; at += LANES) {
        const float *columns = columns_at(given, at), *weights = columns + BLACK * BLOCK_PX;
        const int32_t *pixels = given->pixels + at / BLOCK_PX * (2 * BLOCK_PX) + at % BLOCK_PX;
        const Floats left = residuals_of(columns, solution);
        Floats added[MAX_QUANTITIES];
        for (int32_t q = 0; q < quantities; q++) added[q] = model_at(columns, influences + q * UNKNOWNS) * left;
        for (int i = 0; i < LANES; i++) {
            if (!(weights[i] > 0)) continue;
            line = span_of(line, pixels[i], box_px);
            column = span_of(column, pixels[i + BLOCK_PX], box_px);
            const int32_t v = line.number - extent.top, u = column.number - extent.left;
            double *box = box_at(boxes, v / 2 * across + u / 2, quantities);
            box[QUARTERS * quantities] = 1;
            double *quarter = box + (v % 2 * 2 + u % 2) * quantities;
            for (int32_t q = 0; q < quantities; q++) quarter[q] += (double)added[q][i];
        }
    }
}

/* Add up influences times residuals over boxes of pixels, for the markers picked (picked_count,).
 *
 * Boxes are those of lines and columns divided by box_px, counted from the first that a marker has; large ones are two by
 * two small ones. influences (count, quantities, 15) are by how much each quantity changes with the model's columns.
 * small and large (picked_count, quantities) are the sums, over all boxes of a size, of the square of the sum in a box;
 * boxes (picked_count,) are the numbers of large boxes that have pixels. All are zero at first. Returns 0 or an error. */
int32_t add_over_boxes(const MarkerBlocks *given, const int64_t *picked, int64_t picked_count, const float *solutions,
                       const float *influences, int32_t quantities, int32_t box_px, double *small, double *large,
                       int64_t *boxes) {
    if (box_px <= 0 || quantities <= 0 || quantities > MAX_QUANTITIES || !are_bounds_valid(given)) return FIT_INVALID_SIZE;
    for (int64_t place = 0; place < picked_count; place++) {
        if (picked[place] < 0 || picked[place] >= given->count) return FIT_INVALID_SIZE;
        const int64_t k = picked[place];
        const Extent extent = extent_of(given, k, box_px);
        if (extent.top > extent.bottom) continue;
        const int64_t count = ((int64_t)(extent.bottom - extent.top) / 2 + 1) * ((extent.right - extent.left) / 2 + 1);
        double *sums = calloc((size_t)count, ((size_t)QUARTERS * (size_t)quantities + 1) * sizeof(double));
        if (!sums) return FIT_NO_MEMORY;
        add_to_boxes(given, k, solutions + k * UNKNOWNS, influences + k * quantities * UNKNOWNS, quantities, box_px, extent,
                     sums);
        for (int64_t i = 0; i < count; i++) {
            const double *box = box_at(sums, i, quantities);
            boxes[place] += box[QUARTERS * quantities] > 0;
            for (int32_t q = 0; q < quantities; q++) {
                double whole_box = 0;
                for (int quarter = 0; quarter < QUARTERS; quarter++) {
                    const double part = box[quarter * quantities + q];
                    small[place * quantities + q] += part * part;
                    whole_box += part;
                }
                large[place * quantities + q] += whole_box * whole_box;
            }
        }
        free(sums);
    }
    return 0;
}
