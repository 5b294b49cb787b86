/* An image whose contrast is the same all over, from a gain and a shift for each block of pixels (search/faint.py). */
#include "search.h"

#include <math.h>

/* Place of a pixel's centre among blocks: the block before it, and the share of the next one. */
typedef struct { int32_t before, next; float share; } Between;

static Between between(int32_t pixel, int32_t block_px, int32_t blocks) {
    const float at = ((float)pixel + 0.5f) / (float)block_px - 0.5f, before = floorf(at);
    const int32_t first = before < 0 ? 0 : (int32_t)before;
    return (Between){first < blocks ? first : blocks - 1, first + 1 < blocks ? first + 1 : blocks - 1,
                     before < 0 ? 0.0f : at - before};
}

/* Write a row of values (columns,) of blocks at all pixels (width,), between the middles of an even number of pixels. */
static void enlarge(const float *restrict values, int32_t columns, int32_t block_px, int32_t width,
                    float *restrict enlarged) {
    const int32_t half = block_px / 2, last = half + (columns - 1) * block_px;
    for (int32_t x = 0; x < half && x < width; x++) enlarged[x] = values[0];
    for (int32_t column = 0; column + 1 < columns; column++) {
        const float value = values[column], change = (values[column + 1] - value) / (float)block_px;
        float *restrict part = enlarged + half + (ptrdiff_t)column * block_px;
        for (int32_t x = 0; x < block_px; x++) part[x] = value + ((float)x + 0.5f) * change;
    }
    for (int32_t x = last; x < width; x++) enlarged[x] = values[columns - 1];
}

/* Values of two successive rows of blocks at all pixels of a line. */
typedef struct { float *before, *next; } Lines;

/* Enlarge the rows that are not at hand: those of the line before are given by the row `first`, -1 if there is none. */
static void enlarge_rows(const float *values, int32_t columns, int32_t block_px, int32_t width, Between row, int32_t first,
                         Lines *lines) {
    if (row.before == first) return;
    if (first >= 0) {
        float *swap = lines->before;
        lines->before = lines->next;
        lines->next = swap;
    } else {
        enlarge(values + (ptrdiff_t)row.before * columns, columns, block_px, width, lines->before);
    }
    enlarge(values + (ptrdiff_t)row.next * columns, columns, block_px, width, lines->next);
}

/* Write a line of pixels at the share of the way between both rows. */
static void stretch_line(const uint8_t *restrict from, Lines gains, Lines shifts, float share, int32_t width,
                         uint8_t *restrict to) {
    const float *restrict gain = gains.before, *restrict next_gain = gains.next;
    const float *restrict shift = shifts.before, *restrict next_shift = shifts.next;
    for (int32_t x = 0; x < width; x++) {
        const float factor = gain[x] + share * (next_gain[x] - gain[x]);
        const float value = (float)from[x] * factor + shift[x] + share * (next_shift[x] - shift[x]);
        const float limited = value > 0 ? value < 255 ? value : 255.0f : 0.0f; /* also of no number */
        to[x] = (uint8_t)(int32_t)(limited + 0.5f);
    }
}

/* Write gain times grey level plus shift. Gains and shifts are bilinear between the centres of blocks of pixels.
 *
 * gains and shifts (rows, columns) are those of blocks of block_px x block_px pixels; an incomplete last block has the
 * values of the one before. memory (4, width) is for work, stretched (height, width) the result. Returns 0 or an error. */
int32_t stretch(const uint8_t *image, int32_t width, int32_t height, const float *gains, const float *shifts,
                int32_t columns, int32_t rows, int32_t block_px, float *memory, uint8_t *stretched) {
    if (block_px <= 0 || block_px % 2 || columns <= 0 || rows <= 0 || columns > width / block_px ||
        rows > height / block_px)
        return INVALID_SIZE;
    const ptrdiff_t line = width;
    Lines gain = {memory, memory + line}, shift = {memory + 2 * line, memory + 3 * line};
    int32_t first = -1;
    for (int32_t y = 0; y < height; y++) {
        const Between row = between(y, block_px, rows);
        enlarge_rows(gains, columns, block_px, width, row, first, &gain);
        enlarge_rows(shifts, columns, block_px, width, row, first, &shift);
        first = row.before;
        stretch_line(image + y * line, gain, shift, row.share, width, stretched + y * line);
    }
    return 0;
}
