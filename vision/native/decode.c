/* Which code of a dictionary the cells of quadrilaterals resemble most (vision/search/decode.py).
 *
 * The correlation of standardised rows is their inner product divided by their length. All codes are compared: a lane of a
 * vector sums up the product with one of them, so that every build gives equal bytes. Six rows of samples share a load of
 * the codes, which are stored column by column for this.
 */
#include "floats.h"
#include "search.h"

/* Rows of samples and vectors of codes at a time; codes are padded to a multiple of CODE_STEP. */
enum { ROWS = 6, BLOCK = 2, CODE_STEP = 32, MAX_CELLS = 1 << 10 };

_Static_assert(CODE_STEP % (BLOCK * LANES) == 0, "whole blocks of codes");

/* Codes (cells, stride), of which the first `count` columns are codes. */
typedef struct { const float *columns; int64_t count, stride; int32_t cells; } Codes;

/* The greatest products so far in each lane, and the codes that have them. */
typedef struct { Floats product; Ints code; } Best;

/* Sum up the products of six rows of samples with 2 x LANES codes. */
INLINE void multiply(const float *const rows[ROWS], const float *codes, const Codes *all, Floats sums[ROWS][BLOCK]) {
    for (int row = 0; row < ROWS; row++) sums[row][0] = sums[row][1] = (Floats){0};
    for (int32_t cell = 0; cell < all->cells; cell++) {
        const float *at = codes + cell * all->stride;
        const Floats one = load(at), other = load(at + LANES);
        for (int row = 0; row < ROWS; row++) {
            sums[row][0] += rows[row][cell] * one;
            sums[row][1] += rows[row][cell] * other;
        }
    }
}

/* Of equal products the code of the lower number stays, which is the one that was there before. */
INLINE void keep_larger(Best *best, Floats product, int32_t first, int64_t count) {
    Ints code;
    for (int lane = 0; lane < LANES; lane++) code[lane] = first + lane;
    const Ints is_better = (product > best->product) & (code < (int32_t)count);
    best->product = choose(is_better, product, best->product);
    best->code = (code & is_better) | (best->code & ~is_better);
}

static void write_best(const Best *best, int32_t *code, float *product) {
    int lane = 0;
    for (int k = 1; k < LANES; k++) {
        const int is_greater = best->product[k] > best->product[lane];
        if (is_greater || (best->product[k] == best->product[lane] && best->code[k] < best->code[lane])) lane = k;
    }
    *code = best->code[lane];
    *product = best->product[lane];
}

static int32_t check_codes(int64_t rows, const Codes *codes) {
    if (rows < 0 || codes->cells <= 0 || codes->cells > MAX_CELLS) return INVALID_SIZE;
    const int is_padded = codes->stride % CODE_STEP == 0 && codes->stride <= MAX_PIXELS;
    return codes->count > 0 && codes->count <= codes->stride && is_padded ? 0 : INVALID_PARAMETERS;
}

/* Point to six rows of samples from one on; beyond the last row to that one. */
static void take_rows(const float *samples, int64_t first, int64_t rows, int32_t cells, const float *together[ROWS]) {
    for (int row = 0; row < ROWS; row++)
        together[row] = samples + (first + row < rows ? first + row : rows - 1) * cells;
}

/* Find the code of the greatest inner product with each row of samples (rows, cells).
 *
 * columns (cells, stride) holds `count` codes; the stride is a multiple of CODE_STEP. A row that is not finite may get any
 * code. Returns 0 or an error. */
int32_t best_codes(const float *samples, int64_t rows, int32_t cells, const float *columns, int64_t count, int64_t stride,
                   int32_t *codes, float *products) {
    const Codes known = {columns, count, stride, cells};
    const int32_t error = check_codes(rows, &known);
    if (error) return error;
    for (int64_t first = 0; first < rows; first += ROWS) {
        const float *together[ROWS];
        Best best[ROWS];
        take_rows(samples, first, rows, cells, together);
        for (int row = 0; row < ROWS; row++) best[row] = (Best){all(-INFINITY), (Ints){0}};
        for (int64_t code = 0; code < count; code += BLOCK * LANES) {
            Floats sums[ROWS][BLOCK];
            multiply(together, columns + code, &known, sums);
            for (int row = 0; row < ROWS; row++)
                for (int block = 0; block < BLOCK; block++)
                    keep_larger(best + row, sums[row][block], (int32_t)code + block * LANES, count);
        }
        for (int row = 0; row < ROWS && first + row < rows; row++)
            write_best(best + row, codes + first + row, products + first + row);
    }
    return 0;
}

/* Write the inner products (rows, stride) of rows of samples with all codes, as `best_codes` takes them. */
int32_t code_products(const float *samples, int64_t rows, int32_t cells, const float *columns, int64_t count, int64_t stride,
                      float *products) {
    const Codes known = {columns, count, stride, cells};
    const int32_t error = check_codes(rows, &known);
    if (error) return error;
    for (int64_t first = 0; first < rows; first += ROWS) {
        const float *together[ROWS];
        take_rows(samples, first, rows, cells, together);
        for (int64_t code = 0; code < count; code += BLOCK * LANES) {
            Floats sums[ROWS][BLOCK];
            multiply(together, columns + code, &known, sums);
            for (int row = 0; row < ROWS && first + row < rows; row++)
                for (int block = 0; block < BLOCK; block++)
                    store(sums[row][block], products + (first + row) * stride + code + block * LANES);
        }
    }
    return 0;
}
