/* Which code of a dictionary the cells of quadrilaterals resemble most (vision/search/decode.py).
 *
 * The likeness of a row of cells and a code is their correlation: the inner product of both, standardised, divided by their
 * length. All codes are compared: a lane of a vector sums up the product with one of them, so that every build gives equal
 * bytes. Six rows share a load of the codes, which are stored column by column for this.
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

/* Find the codes of the greatest products with six rows. */
static void best_of(const float *const rows[ROWS], const Codes *known, Best best[ROWS]) {
    for (int row = 0; row < ROWS; row++) best[row] = (Best){all(-INFINITY), (Ints){0}};
    for (int64_t code = 0; code < known->count; code += BLOCK * LANES) {
        Floats sums[ROWS][BLOCK];
        multiply(rows, known->columns + code, known, sums);
        for (int row = 0; row < ROWS; row++)
            for (int block = 0; block < BLOCK; block++)
                keep_larger(best + row, sums[row][block], (int32_t)code + block * LANES, known->count);
    }
}

/* Mean and standard deviation of a row of cells, grey levels. */
typedef struct { double mean, deviation; } Levels;

/* Standardise a row of cells to mean 0 and standard deviation 1. */
static Levels standardise(const float *restrict cells, int32_t count, double min_deviation, float *restrict standard) {
    double sum = 0, squares = 0;
    for (int32_t i = 0; i < count; i++) sum += (double)cells[i];
    const double mean = sum / count;
    for (int32_t i = 0; i < count; i++) squares += ((double)cells[i] - mean) * ((double)cells[i] - mean);
    const double deviation = sqrt(squares / count), scale = 1 / fmax(deviation, min_deviation);
    for (int32_t i = 0; i < count; i++) standard[i] = (float)(((double)cells[i] - mean) * scale);
    return (Levels){mean, deviation};
}

/* Cells to be decoded, and the results. */
typedef struct { const float *cells; int32_t count; const DecodeConstants *constants; Decoded *decoded; } Rows;

/* Compare up to six rows of cells, `due`, with the codes of a table. A row resembles one of them if its likeness is at least
 * `least`, and above that of other tables so far. */
static void compare_rows(const Rows *rows, const int64_t *due, int count, const CodeTable *table, double least) {
    const Codes known = {table->columns, table->count, table->stride, rows->count};
    float standard[ROWS][MAX_CELLS];
    const float *together[ROWS];
    Levels levels[ROWS];
    Best best[ROWS];
    for (int row = 0; row < ROWS; row++) {
        together[row] = standard[row < count ? row : count - 1];
        if (row >= count) continue;
        levels[row] = standardise(rows->cells + due[row] * rows->count, rows->count, rows->constants->min_deviation,
                                  standard[row]);
    }
    best_of(together, &known, best);
    for (int row = 0; row < count; row++) {
        Decoded *decoded = rows->decoded + due[row];
        int32_t code;
        float product;
        write_best(best + row, &code, &product);
        const double likeness = (double)product / rows->count;
        decoded->deviation = levels[row].deviation;
        if (!(likeness > decoded->likeness && likeness >= least)) continue;
        const double contrast = likeness * levels[row].deviation / table->deviations[code];
        const double white = levels[row].mean + contrast * table->means[code];
        decoded->likeness = likeness;
        decoded->print_contrast = contrast / fmax(white, rows->constants->min_white);
        decoded->code = code;
    }
}

/* Find the code that each row of cells (rows, cells) resembles most.
 *
 * table_of_row (rows,) is the number of the table of codes that a row is compared with. It is also compared with the last one,
 * of strongly blurred codes, if its likeness is at least the `least` of its own table. decoded (rows,) is the result. Returns 0
 * or an error. */
int32_t decode_cells(const float *cells, int64_t rows, int32_t cells_count, const int32_t *table_of_row,
                     const CodeTable *tables, int32_t table_count, const DecodeConstants *constants, Decoded *decoded) {
    if (rows < 0 || table_count <= 0) return INVALID_SIZE;
    for (int32_t t = 0; t < table_count; t++) {
        const Codes known = {tables[t].columns, tables[t].count, tables[t].stride, cells_count};
        const int32_t error = check_codes(rows, &known);
        if (error) return error;
    }
    const Rows all_rows = {cells, cells_count, constants, decoded};
    for (int64_t row = 0; row < rows; row++) {
        if (table_of_row[row] < 0 || table_of_row[row] >= table_count) return INVALID_PARAMETERS;
        decoded[row] = (Decoded){.likeness = -INFINITY};
    }
    for (int32_t pass = 0; pass <= table_count; pass++) {
        const int is_last = pass == table_count;
        const CodeTable *table = tables + (is_last ? table_count - 1 : pass);
        int64_t due[ROWS];
        int count = 0;
        for (int64_t row = 0; row < rows; row++) {
            const int32_t own = table_of_row[row];
            if (!(is_last ? decoded[row].likeness >= tables[own].least : own == pass)) continue;
            due[count++] = row;
            if (count == ROWS) compare_rows(&all_rows, due, count, table, is_last ? table->least : -INFINITY), count = 0;
        }
        if (count) compare_rows(&all_rows, due, count, table, is_last ? table->least : -INFINITY);
    }
    return 0;
}

/* Write the inner products (rows, stride) of rows of samples (rows, cells) with all codes.
 *
 * columns (cells, stride) holds `count` codes; the stride is a multiple of CODE_STEP. Returns 0 or an error. */
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
