/* Two images whose contrasts are the same all over, from gains and shifts for blocks of pixels (search/faint.py). */
#include "search.h"

#include <math.h>

enum { BLOCK = 4 };

/* Place of a line among rows of blocks: the row before its centre, the next one, and the share of that. */
typedef struct { int32_t before, next; float share; } Between;

static Between between(int32_t y, int32_t rows) {
    const float at = ((float)y + 0.5f) / BLOCK - 0.5f, before = floorf(at);
    const int32_t first = before < 0 ? 0 : (int32_t)before;
    return (Between){first < rows ? first : rows - 1, first + 1 < rows ? first + 1 : rows - 1,
                     before < 0 ? 0.0f : at - before};
}

typedef float Four __attribute__((vector_size(BLOCK * sizeof(float))));

/* Write a row of values (columns,) of blocks at all pixels (width,). */
static void enlarge(const float *restrict values, int32_t columns, int32_t width, float *restrict enlarged) {
    const Four shares = {0.125f, 0.375f, 0.625f, 0.875f}; /* of the way to the next block's centre */
    const int32_t half = BLOCK / 2, last = half + (columns - 1) * BLOCK;
    for (int32_t x = 0; x < half; x++) enlarged[x] = values[0];
    for (int32_t column = 0; column + 1 < columns; column++) {
        const Four part = values[column] + (values[column + 1] - values[column]) * shares;
        memcpy(enlarged + half + (ptrdiff_t)column * BLOCK, &part, sizeof part);
    }
    for (int32_t x = last; x < width; x++) enlarged[x] = values[columns - 1];
}

/* Values of two successive rows of blocks at all pixels of a line. */
typedef struct { float *before, *next; } Lines;

/* Enlarge the rows that are not at hand: those of the line above are given by the row `first`, -1 if there is none. */
static void enlarge_rows(const float *values, int32_t columns, int32_t width, Between row, int32_t first, Lines *lines) {
    if (row.before == first) return;
    if (first >= 0) {
        float *swap = lines->before;
        lines->before = lines->next;
        lines->next = swap;
    } else {
        enlarge(values + (ptrdiff_t)row.before * columns, columns, width, lines->before);
    }
    enlarge(values + (ptrdiff_t)row.next * columns, columns, width, lines->next);
}

/* Write a line of pixels times gains, plus shifts, at the share of the way between both rows. */
static void stretch_line(const uint8_t *restrict from, Lines gains, Lines shifts, float share, int32_t width,
                         uint8_t *restrict to) {
    const float *restrict gain = gains.before, *restrict next_gain = gains.next;
    const float *restrict shift = shifts.before, *restrict next_shift = shifts.next;
    for (int32_t x = 0; x < width; x++) {
        const float factor = gain[x] + share * (next_gain[x] - gain[x]);
        const float value = (float)from[x] * factor + shift[x] + share * (next_shift[x] - shift[x]);
        const float positive = value > 0 ? value : 0.0f; /* also of no number */
        const float limited = positive < 255 ? positive : 255.0f;
        to[x] = (uint8_t)(int32_t)(limited + 0.5f);
    }
}

/* Write a line under the binomial filter of 3 x 3 pixels, mirrored at the borders as by cv2.GaussianBlur. */
static void smooth_line(const uint8_t *restrict above, const uint8_t *restrict line, const uint8_t *restrict below,
                        int32_t width, uint16_t *restrict sums, uint8_t *restrict smooth) {
    for (int32_t x = 0; x < width; x++) sums[x] = (uint16_t)(above[x] + 2 * line[x] + below[x]);
    const int32_t last = width - 1;
    smooth[0] = (uint8_t)((2 * sums[0] + 2 * sums[1] + 8) >> 4);
    for (int32_t x = 1; x < last; x++) smooth[x] = (uint8_t)((sums[x - 1] + 2 * sums[x] + sums[x + 1] + 8) >> 4);
    smooth[last] = (uint8_t)((2 * sums[last] + 2 * sums[last - 1] + 8) >> 4);
}

/* Write the pixels of the blocks that stay sharp (columns,), 255 or 0, and the smooth ones of the others. */
static void choose_line(const uint8_t *restrict line, const uint8_t *restrict smooth, const uint8_t *restrict is_sharp,
                        int32_t columns, int32_t width, uint8_t *restrict chosen) {
    const uint32_t ones = 0x01010101;
    for (int32_t column = 0; column < columns; column++) {
        uint32_t block, smooth_block; /* BLOCK pixels each */
        memcpy(&block, line + BLOCK * column, sizeof block);
        memcpy(&smooth_block, smooth + BLOCK * column, sizeof block);
        const uint32_t kept = is_sharp[column] * ones;
        block = (block & kept) | (smooth_block & ~kept);
        memcpy(chosen + BLOCK * column, &block, sizeof block);
    }
    for (int32_t x = columns * BLOCK; x < width; x++) chosen[x] = is_sharp[columns - 1] ? line[x] : smooth[x];
}

/* Write two images: gain times grey level plus shift. Gains and shifts are bilinear between the centres of blocks.
 *
 * gains and shifts (2, rows, columns) are those of blocks of 4 x 4 pixels; an incomplete last block has the values of the
 * one before. The second image is smoothed, and the first one too but in blocks where is_sharp (rows, columns) is 255.
 * memory (10, width) is for work, stretched (2, height, width) the result. Returns 0 or an error. */
int32_t stretch(const uint8_t *image, int32_t width, int32_t height, const float *gains, const float *shifts,
                const uint8_t *is_sharp, int32_t columns, int32_t rows, float *memory, uint8_t *stretched) {
    if (columns <= 0 || rows <= 0 || columns > width / BLOCK || rows > height / BLOCK) return INVALID_SIZE;
    const ptrdiff_t line = width, plane = line * height, blocks = (ptrdiff_t)rows * columns;
    Lines gain[2], shift[2];
    for (int i = 0; i < 2; i++, memory += 4 * line) {
        gain[i] = (Lines){memory, memory + line};
        shift[i] = (Lines){memory + 2 * line, memory + 3 * line};
    }
    uint16_t *sums = (uint16_t *)memory;
    uint8_t *smooth = (uint8_t *)(sums + line), *chosen = smooth + line;
    int32_t first = -1;
    for (int32_t y = 0; y < height; y++) {
        const uint8_t *here = image + y * line;
        smooth_line(y > 0 ? here - line : here + line, here, y + 1 < height ? here + line : here - line, width, sums, smooth);
        const int32_t own = y / BLOCK < rows ? y / BLOCK : rows - 1;
        choose_line(here, smooth, is_sharp + (ptrdiff_t)own * columns, columns, width, chosen);
        const Between row = between(y, rows);
        for (int i = 0; i < 2; i++) {
            enlarge_rows(gains + i * blocks, columns, width, row, first, gain + i);
            enlarge_rows(shifts + i * blocks, columns, width, row, first, shift + i);
            stretch_line(i ? smooth : chosen, gain[i], shift[i], row.share, width, stretched + i * plane + y * line);
        }
        first = row.before;
    }
    return 0;
}
