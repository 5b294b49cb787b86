/* Products of the model's columns, and residuals: of each pixel, and summed over cells and over boxes of pixels. */
#include "fit.h"

#include <math.h>
#include <stdlib.h>

enum { WIDTH = COLUMNS, BLOCK = 64, QUARTERS = 4, MAX_QUANTITIES = 8 };

typedef float Half __attribute__((vector_size(2 * WIDTH)));
typedef float Quarter __attribute__((vector_size(WIDTH)));

/* 16 values: those of a row, or factors of them. */
typedef struct { Half low, high; } Row;

static inline Row row_at(const float *values) {
    Row row;
    __builtin_memcpy(&row.low, values, sizeof row.low);
    __builtin_memcpy(&row.high, values + WIDTH / 2, sizeof row.high);
    return row;
}

/* Return the sum of the products of two rows. Pairs that are 8, 4, 2 and 1 apart are added. */
static inline float dot(Row a, Row b) {
    const Half half = a.low * b.low + a.high * b.high;
    Quarter parts[2];
    __builtin_memcpy(parts, &half, sizeof parts);
    const Quarter sums = parts[0] + parts[1];
    return (sums[0] + sums[2]) + (sums[1] + sums[3]);
}

/* Return factors (15,) with one more for the pixel's own value. */
static inline Row factors_of(const float *factors, float of_pixel) {
    float values[WIDTH];
    for (int i = 0; i < UNKNOWNS; i++) values[i] = factors[i];
    values[PIXEL] = of_pixel;
    return row_at(values);
}

/* Return a pixel less the model at it, times the pixel's weight; of the model the factors are -1 for the pixel. */
static inline float residual_of(const float *columns, int64_t row, Row model) {
    return -dot(row_at(columns + row * WIDTH), model);
}

/* Add to `total` the products of `count` columns from `first` on with all from `second` on, over a block of rows. */
static inline __attribute__((always_inline)) void add_products(int count, int first, int second, const float *block,
                                                               int64_t rows, double total[WIDTH][WIDTH]) {
    enum { MAX = 8 };
    Half low[MAX] = {{0}}, high[MAX] = {{0}};
    for (int64_t row = 0; row < rows; row++) {
        const float *values = block + row * WIDTH;
        Half left = {0}, right;
        if (second == 0) __builtin_memcpy(&left, values, sizeof left);
        __builtin_memcpy(&right, values + MAX, sizeof right);
        for (int i = 0; i < count; i++) {
            if (second == 0) low[i] += values[first + i] * left;
            high[i] += values[first + i] * right;
        }
    }
    for (int i = 0; i < count; i++)
        for (int j = 0; j < MAX; j++) {
            if (second == 0) total[first + i][j] += (double)low[i][j];
            total[first + i][MAX + j] += (double)high[i][j];
        }
}

/* Compute the products (count, 16, 16) of the columns of each marker. Blocks of rows are added up in single precision, and
 * the blocks in double precision. */
int32_t gram_matrices(const MarkerRows *given, float *grams) {
    if (!are_bounds_valid(given)) return FIT_INVALID_SIZE;
    for (int64_t k = 0; k < given->count; k++, grams += WIDTH * WIDTH) {
        double total[WIDTH][WIDTH] = {{0}};
        for (int64_t begin = given->bounds[k]; begin < given->bounds[k + 1]; begin += BLOCK) {
            const int64_t rest = given->bounds[k + 1] - begin, rows = rest < BLOCK ? rest : BLOCK;
            const float *block = given->columns + begin * WIDTH;
            add_products(4, 0, 0, block, rows, total); /* so many sums at a time stay in registers */
            add_products(4, 4, 0, block, rows, total);
            add_products(8, 8, 8, block, rows, total);
        }
        for (int i = 0; i < WIDTH; i++)
            for (int j = i; j < WIDTH; j++) grams[i * WIDTH + j] = grams[j * WIDTH + i] = (float)total[i][j];
    }
    return 0;
}

/* Compute the weighted residuals (rows,), grey levels, of the model at solutions (count, 15). */
int32_t residuals(const MarkerRows *given, const float *solutions, float *left) {
    if (!are_bounds_valid(given)) return FIT_INVALID_SIZE;
    for (int64_t k = 0; k < given->count; k++) {
        const Row model = factors_of(solutions + k * UNKNOWNS, -1.0f);
        for (int64_t row = given->bounds[k]; row < given->bounds[k + 1]; row++)
            left[row] = residual_of(given->columns, row, model);
    }
    return 0;
}

/* Add up residuals over the cells of each marker. All results are zero at first.
 *
 * sums, used and read (count, n, n) are the residuals over each cell, the number of its pixels that have a weight, and that
 * of all its pixels. peaks (count,) are the largest absolute residuals of a pixel. Returns 0 or an error. */
int32_t add_over_cells(const MarkerRows *given, const float *solutions, int32_t n, double *sums, double *used,
                       double *read, double *peaks) {
    if (n <= 0 || n > MAX_CELLS || !are_bounds_valid(given)) return FIT_INVALID_SIZE;
    const float half = (float)n / 2, cells = (float)n, *columns = given->columns, *places = given->places;
    const int64_t *bounds = given->bounds;
    for (int64_t k = 0; k < given->count; k++) {
        const Row model = factors_of(solutions + k * UNKNOWNS, -1.0f);
        const int64_t first = k * n * n;
        float largest = 0;
        for (int64_t row = bounds[k]; row < bounds[k + 1]; row++) {
            const float left = residual_of(columns, row, model);
            const float across = places[2 * row] * cells + half, down = places[2 * row + 1] * cells + half;
            largest = fabsf(left) > largest ? fabsf(left) : largest;
            if (!(across >= 0 && down >= 0 && across < cells && down < cells)) continue;
            const int64_t cell = first + (int64_t)(int32_t)down * n + (int32_t)across;
            sums[cell] += (double)left;
            used[cell] += columns[row * WIDTH + BLACK] > 0;
            read[cell] += 1;
        }
        peaks[k] = (double)largest;
    }
    return 0;
}

/* Lines and columns of boxes that a marker's pixels lie in. */
typedef struct { int32_t top, left, bottom, right; } Extent;

static Extent extent_of(const float *columns, const int32_t *pixels, int64_t begin, int64_t end, int32_t box_px) {
    Extent extent = {INT32_MAX, INT32_MAX, 0, 0};
    for (int64_t row = begin; row < end; row++) {
        if (!(columns[row * WIDTH + BLACK] > 0)) continue;
        const int32_t v = pixels[2 * row] / box_px, u = pixels[2 * row + 1] / box_px;
        extent.top = v < extent.top ? v : extent.top;
        extent.bottom = v > extent.bottom ? v : extent.bottom;
        extent.left = u < extent.left ? u : extent.left;
        extent.right = u > extent.right ? u : extent.right;
    }
    return extent;
}

/* Sums of one large box: of each quantity over each quarter, and whether it has a pixel. */
static inline double *box_at(double *boxes, int64_t index, int32_t quantities) {
    return boxes + index * (QUARTERS * quantities + 1);
}

/* Add influences times residuals of a marker's pixels to boxes. */
static void add_to_boxes(const float *columns, const int32_t *pixels, int64_t begin, int64_t end, const float *solution,
                         const float *influences, int32_t quantities, int32_t box_px, Extent extent, double *boxes) {
    const int64_t across = (extent.right - extent.left) / 2 + 1;
    const Row model = factors_of(solution, -1.0f);
    Row factors[MAX_QUANTITIES];
    for (int32_t q = 0; q < quantities; q++) factors[q] = factors_of(influences + q * UNKNOWNS, 0.0f);
    for (int64_t row = begin; row < end; row++) {
        if (!(columns[row * WIDTH + BLACK] > 0)) continue;
        const int32_t v = pixels[2 * row] / box_px - extent.top, u = pixels[2 * row + 1] / box_px - extent.left;
        double *box = box_at(boxes, v / 2 * across + u / 2, quantities);
        box[QUARTERS * quantities] = 1;
        const float left = residual_of(columns, row, model);
        double *quarter = box + (v % 2 * 2 + u % 2) * quantities;
        for (int32_t q = 0; q < quantities; q++)
            quarter[q] += (double)(dot(row_at(columns + row * WIDTH), factors[q]) * left);
    }
}

/* Add up influences times residuals over boxes of pixels, for the markers picked (picked_count,).
 *
 * Boxes are those of lines and columns divided by box_px, counted from the first that a marker has; large ones are two by
 * two small ones. influences (count, quantities, 15) are by how much each quantity changes with the model's columns.
 * small and large (picked_count, quantities) are the sums, over all boxes of a size, of the square of the sum in a box;
 * boxes (picked_count,) are the numbers of large boxes that have pixels. All are zero at first. Returns 0 or an error. */
int32_t add_over_boxes(const MarkerRows *given, const int64_t *picked, int64_t picked_count, const float *solutions,
                       const float *influences, int32_t quantities, int32_t box_px, double *small, double *large,
                       int64_t *boxes) {
    if (box_px <= 0 || quantities <= 0 || quantities > MAX_QUANTITIES || !are_bounds_valid(given)) return FIT_INVALID_SIZE;
    const float *columns = given->columns;
    const int32_t *pixels = given->pixels;
    for (int64_t place = 0; place < picked_count; place++) {
        if (picked[place] < 0 || picked[place] >= given->count) return FIT_INVALID_SIZE;
        const int64_t k = picked[place], begin = given->bounds[k], end = given->bounds[k + 1];
        const Extent extent = extent_of(columns, pixels, begin, end, box_px);
        if (extent.top > extent.bottom) continue;
        const int64_t count = ((int64_t)(extent.bottom - extent.top) / 2 + 1) * ((extent.right - extent.left) / 2 + 1);
        double *sums = calloc((size_t)count, ((size_t)QUARTERS * (size_t)quantities + 1) * sizeof(double));
        if (!sums) return FIT_NO_MEMORY;
        add_to_boxes(columns, pixels, begin, end, solutions + k * UNKNOWNS, influences + k * quantities * UNKNOWNS,
                     quantities, box_px, extent, sums);
        for (int64_t i = 0; i < count; i++) {
            const double *box = box_at(sums, i, quantities);
            boxes[place] += box[QUARTERS * quantities] > 0;
            for (int32_t q = 0; q < quantities; q++) {
                double whole = 0;
                for (int quarter = 0; quarter < QUARTERS; quarter++) {
                    const double part = box[quarter * quantities + q];
                    small[place * quantities + q] += part * part;
                    whole += part;
                }
                large[place * quantities + q] += whole * whole;
            }
        }
        free(sums);
    }
    return 0;
}
