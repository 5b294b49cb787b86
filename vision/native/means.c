/* Adaptive threshold by running box sums, and erosion. Means equal cv2.blur with its default border. */
#include "search.h"

#include <string.h>

enum { PART_PX = 5 };

/* Return the index of `at` within 0..length-1, mirrored at the ends without repeating them. */
static int32_t mirrored(int32_t at, int32_t length) {
    const int32_t last = length - 1, forward = at < 0 ? -at : at;
    if (forward <= last) return forward;
    if (forward <= 2 * last) return 2 * last - forward;
    if (last == 0) return 0;
    const int32_t rest = forward % (2 * last); /* windows wider than the image are mirrored several times */
    return rest <= last ? rest : 2 * last - rest;
}

static void add_row(uint16_t *restrict sums, const uint8_t *restrict row, int32_t width) {
    for (int32_t x = 0; x < width; x++) sums[x] = (uint16_t)(sums[x] + row[x]);
}

static void replace_row(uint16_t *restrict sums, const uint8_t *restrict added, const uint8_t *restrict removed,
                        int32_t width) {
    for (int32_t x = 0; x < width; x++) sums[x] = (uint16_t)(sums[x] + added[x] - removed[x]);
}

/* Sums over `window_px` neighbours; the callers pass a constant, so that the inner loop is unrolled. */
static inline __attribute__((always_inline)) void sum_neighbours(const uint16_t *restrict columns,
                                                                 uint16_t *restrict sums, int32_t count,
                                                                 int32_t window_px) {
    for (int32_t x = 0; x < count; x++) {
        uint16_t sum = columns[x];
        for (int32_t k = 1; k < window_px; k++) sum = (uint16_t)(sum + columns[x + k]);
        sums[x] = sum;
    }
}

/* Means of a small window: floor((sum + area / 2) / area), by a multiplication with 2^(16 + shift) / area, rounded up.
 * It is exact for sums up to 255 * area: its relative error is below 1 / (255 * area + area / 2). */
static inline __attribute__((always_inline)) void small_window_means(const uint16_t *restrict columns,
                                                                     uint8_t *restrict means, int32_t width,
                                                                     int32_t window_px, int32_t shift) {
    const uint32_t area = (uint32_t)(window_px * window_px);
    const uint32_t factor = ((1u << (16 + shift)) + area - 1) / area;
    for (int32_t x = 0; x < width; x++) {
        uint16_t sum = (uint16_t)(area / 2);
        for (int32_t k = 0; k < window_px; k++) sum = (uint16_t)(sum + columns[x + k]);
        means[x] = (uint8_t)((uint16_t)((sum * factor) >> 16) >> shift);
    }
}

/* Means of the large window, from sums over parts of five columns. Sums of 11 columns fit 16 bits, those of 21 do not.
 * Single precision is exact enough: sum / 441 differs from a half by 1 / 882 at least, the product's error is 3e-5. */
static void large_window_means(const uint16_t *restrict columns, const uint16_t *restrict parts,
                               uint8_t *restrict means, int32_t width) {
    const float share = 1.0f / (LARGE_WINDOW_PX * LARGE_WINDOW_PX);
    for (int32_t x = 0; x < width; x++) {
        const uint16_t left = (uint16_t)(parts[x] + parts[x + PART_PX]);
        const uint16_t right = (uint16_t)(parts[x + 2 * PART_PX] + parts[x + 3 * PART_PX] + columns[x + 4 * PART_PX]);
        means[x] = (uint8_t)(int32_t)((float)((int32_t)left + right) * share + 0.5f);
    }
}

static int is_compiled(int32_t window_px) {
    return window_px == 3 || window_px == 5 || window_px == 9 || window_px == LARGE_WINDOW_PX;
}

/* Compute the means of one row from the sums of its columns, which begin `window_px / 2` left of the image. */
static void row_means(const uint16_t *columns, uint16_t *parts, int32_t width, int32_t window_px, uint8_t *means) {
    switch (window_px) {
    case 3: small_window_means(columns, means, width, 3, 3); break;
    case 5: small_window_means(columns, means, width, 5, 4); break;
    case 9: small_window_means(columns, means, width, 9, 6); break;
    default:
        sum_neighbours(columns, parts, width + 3 * PART_PX, PART_PX);
        large_window_means(columns, parts, means, width);
    }
}

/* Rows of a plane: all of them, or the last ones in a ring. */
typedef struct { const uint8_t *pixels; ptrdiff_t stride; int32_t last_index; } Rows;

static inline const uint8_t *row_at(const Rows *rows, int32_t y) {
    return rows->pixels + (y & rows->last_index) * rows->stride;
}

/* Rows that a step of the threshold reads, their size, and sums over the columns of a window about the row at hand. */
typedef struct { Rows from; int32_t width, height, window_px; uint16_t *padded, *parts; } Box;

/* Compute the sums over the columns of a box about row y. The rows are to be asked for one after the other. */
static void sum_columns(const Box *box, int32_t y) {
    const int32_t reach = box->window_px / 2, width = box->width, height = box->height;
    uint16_t *columns = box->padded + reach;
    if (y == 0) {
        memset(columns, 0, (size_t)width * sizeof *columns);
        for (int32_t v = -reach; v <= reach; v++) add_row(columns, row_at(&box->from, mirrored(v, height)), width);
    } else {
        const uint8_t *added = row_at(&box->from, mirrored(y + reach, height));
        replace_row(columns, added, row_at(&box->from, mirrored(y - reach - 1, height)), width);
    }
    for (int32_t x = 1; x <= reach; x++) {
        columns[-x] = columns[mirrored(-x, width)];
        columns[width - 1 + x] = columns[mirrored(width - 1 + x, width)];
    }
}

/* Compute the means over a box around pixels `from <= x < to` of the row whose columns are summed. */
static void box_means(const Box *box, int32_t from, int32_t to, uint8_t *means) {
    row_means(box->padded + from, box->parts, to - from, box->window_px, means + from);
}

/* Compute the means over a box around each pixel of row y. */
static void box_row(const Box *box, int32_t y, uint8_t *means) {
    sum_columns(box, y);
    box_means(box, 0, box->width, means);
}

/* Sharpen by an unsharp mask: twice the smooth row less the wide mean, within 0 to 255. */
static void sharpen(const uint8_t *restrict smooth, const uint8_t *restrict wide, uint8_t *restrict sharp,
                    int32_t width) {
    for (int32_t x = 0; x < width; x++) {
        int16_t value = (int16_t)(2 * smooth[x] - wide[x]);
        value = value < 0 ? 0 : value;
        sharp[x] = (uint8_t)(value > 255 ? 255 : value);
    }
}

/* Write as 255 the pixels of a row that are darker than the larger of two means, and the others as 0. */
static void compare(const uint8_t *small, const uint8_t *large, const uint8_t *restrict sharp, uint8_t *restrict dark,
                    int32_t width, int32_t darker) {
    for (int32_t x = 0; x < width; x++) {
        const uint8_t mean = small[x] > large[x] ? small[x] : large[x];
        dark[x] = (int16_t)(mean - sharp[x]) > (int16_t)darker ? DARK : 0;
    }
}

/* Boxes of one image: two of the unsharp mask, one after the other, that of the noise filter, and both windows. */
enum { SHARPENING, SHARPENING_AGAIN, SMOOTHING, SMALL_WINDOW, LARGE_WINDOW };

/* Steps of the threshold, and how many rows of either ring have been computed. */
typedef struct { Box boxes[BOXES]; int32_t mean_rows, sharp_rows; } ThresholdSteps;

static int begin_steps(const uint8_t *image, int32_t width, int32_t height, const SearchParameters *parameters,
                       const Workspace *work, ThresholdSteps *steps) {
    const Rows all = {image, width, INT32_MAX}, means = {work->means, width, MEAN_ROWS - 1},
               sharp = {work->sharp, width, SHARP_ROWS - 1};
    const Rows from[BOXES] = {all, means, all, sharp, sharp};
    const int32_t windows[BOXES] = {parameters->sharpening_px, parameters->sharpening_px, parameters->smoothing_px,
                                    parameters->small_window_px, parameters->large_window_px};
    for (int i = 0; i < BOXES; i++) {
        const int32_t most = i == SHARPENING_AGAIN ? MEAN_ROWS - 2 : LARGE_WINDOW_PX;
        if (windows[i] > most || !is_compiled(windows[i])) return INVALID_PARAMETERS;
        uint16_t *padded = work->column_sums + i * (width + 2 * LARGE_WINDOW_PX);
        steps->boxes[i] = (Box){from[i], width, height, windows[i], padded, work->window_sums};
    }
    steps->mean_rows = steps->sharp_rows = 0;
    return 0;
}

/* Compute the next row of the sharpened image, and the rows of means that it needs. */
static void next_sharp_row(const Workspace *work, ThresholdSteps *steps) {
    const Box *boxes = steps->boxes;
    const int32_t y = steps->sharp_rows++, width = boxes[0].width, height = boxes[0].height;
    const int32_t last = y + boxes[SHARPENING_AGAIN].window_px / 2;
    for (; steps->mean_rows <= last && steps->mean_rows < height; steps->mean_rows++)
        box_row(boxes + SHARPENING, steps->mean_rows, work->means + steps->mean_rows % MEAN_ROWS * (ptrdiff_t)width);
    box_row(boxes + SHARPENING_AGAIN, y, work->wide);
    box_row(boxes + SMOOTHING, y, work->smooth);
    sharpen(work->smooth, work->wide, work->sharp + y % SHARP_ROWS * (ptrdiff_t)width, width);
}

/* Pixels `from <= x < to` of a row; `from` is a multiple of 64, and so is `to` unless it is the end of the row. */
typedef struct { int32_t from, to; } Segment;

/* Return whether 64 pixels of a row from x on have a place. `kept` is a row of the places, of half the size. */
static int has_place(const uint8_t *kept, int32_t x, int32_t width) {
    const int32_t end = x + BITS < width ? x + BITS : width;
    uint8_t any = 0;
    for (int32_t i = x / 2; i < end / 2; i++) any |= kept[i];
    return any;
}

/* Return the first segment from x on that has places all along; it is empty at the end of the row. */
static Segment next_segment(const uint8_t *kept, int32_t x, int32_t width) {
    while (x < width && !has_place(kept, x, width)) x += BITS;
    Segment segment = {x < width ? x : width, x};
    while (segment.to < width && has_place(kept, segment.to, width)) segment.to += BITS;
    segment.to = segment.to < width ? segment.to : width;
    return segment;
}

/* Clear the pixels of a segment outside of the places. */
static void keep_places(uint8_t *restrict row, const uint8_t *restrict kept, Segment segment) {
    for (int32_t x = segment.from / 2; x < segment.to / 2; x++) {
        row[2 * x] &= kept[x];
        row[2 * x + 1] &= kept[x];
    }
}

/* Return eight pixels, 0 or 255, as bits. */
static uint8_t packed(const uint8_t *pixels) {
    uint64_t eight;
    memcpy(&eight, pixels, sizeof eight);
    eight &= 0x8040201008040201u; /* bit i of byte i */
    for (int apart = BITS / 2; apart >= BITS_PER_BYTE; apart /= 2) eight |= eight >> apart;
    return (uint8_t)eight;
}

/* Write a segment of a mask's row, whose bits are 0, from its pixels, 0 or 255. */
static void pack(const uint8_t *pixels, uint8_t *row, Segment segment) {
    const int32_t first = segment.from / BITS_PER_BYTE, end = segment.to / BITS_PER_BYTE, left = segment.to % BITS_PER_BYTE;
    for (int32_t byte = first; byte < end; byte++) row[byte] = packed(pixels + BITS_PER_BYTE * (ptrdiff_t)byte);
    uint8_t rest[BITS_PER_BYTE] = {0};
    memcpy(rest, pixels + BITS_PER_BYTE * (ptrdiff_t)end, (size_t)left);
    if (left) row[end] = packed(rest);
}

static void clear_row(const Mask *mask, int32_t y) {
    memset(mask_row(mask, y), 0, (size_t)(mask->stride - WORD_BYTES));
}

/* Find the dark pixels of row y of the sharpened image where it has places; both windows' columns are summed. */
static void threshold_row(const Box boxes[BOXES], const uint8_t *kept, int32_t y, int32_t darker, Workspace *work) {
    const int32_t width = boxes[0].width;
    const uint8_t *sharp = work->sharp + y % SHARP_ROWS * (ptrdiff_t)width;
    Segment segment = next_segment(kept, 0, width);
    for (; segment.from < width; segment = next_segment(kept, segment.to, width)) {
        const int32_t from = segment.from;
        box_means(boxes + SMALL_WINDOW, from, segment.to, work->smooth);
        box_means(boxes + LARGE_WINDOW, from, segment.to, work->wide);
        compare(work->smooth + from, work->wide + from, sharp + from, work->compared + from, segment.to - from, darker);
        keep_places(work->compared, kept, segment);
        pack(work->compared, mask_row(&work->dark, y), segment);
    }
}

/* Find the pixels of the sharpened image that are darker than the larger of two local means.
 *
 * `places` is a plane of half the size, 255 where pixels count. The steps follow each other row by row, so that all rows
 * at hand stay in the processor's cache. */
int threshold(const uint8_t *image, const uint8_t *places, int32_t width, int32_t height,
              const SearchParameters *parameters, Workspace *work) {
    ThresholdSteps steps;
    if (begin_steps(image, width, height, parameters, work, &steps)) return INVALID_PARAMETERS;
    const int32_t small_px = parameters->small_window_px, large_px = parameters->large_window_px;
    const int32_t reach = (small_px > large_px ? small_px : large_px) / 2;
    for (int32_t y = 0; y < height; y++) {
        while (steps.sharp_rows <= y + reach && steps.sharp_rows < height) next_sharp_row(work, &steps);
        sum_columns(steps.boxes + SMALL_WINDOW, y);
        sum_columns(steps.boxes + LARGE_WINDOW, y);
        clear_row(&work->dark, y);
        threshold_row(steps.boxes, places + (ptrdiff_t)(y / 2) * (width / 2), y, parameters->darker, work);
    }
    return 0;
}

/* Find the pixels of an image that are darker than the mean of the large window. */
void threshold_plain(const uint8_t *image, int32_t width, int32_t height, int32_t darker, Workspace *work) {
    const Box box = {{image, width, INT32_MAX}, width, height, LARGE_WINDOW_PX, work->column_sums, work->window_sums};
    for (int32_t y = 0; y < height; y++) {
        box_row(&box, y, work->wide);
        compare(work->wide, work->wide, image + (ptrdiff_t)y * width, work->compared, width, darker);
        clear_row(&work->dark, y);
        pack(work->compared, mask_row(&work->dark, y), (Segment){0, width});
    }
}

/* Keep the pixels whose eight neighbours are all dark. Neighbours outside of the image count as dark. */
void erode(const Mask *mask, const Mask *eroded, uint8_t *scratch) {
    const int32_t last_y = mask->height - 1, left = mask->width % BITS_PER_BYTE;
    const ptrdiff_t bytes = mask->stride - WORD_BYTES, last = (mask->width - 1) / BITS_PER_BYTE;
    const uint8_t beyond = left ? (uint8_t)(DARK << left) : 0; /* bits of the last byte that are no pixels */
    uint8_t *column = scratch + 1;
    column[-1] = column[last + 1] = DARK;
    for (int32_t y = 0; y <= last_y; y++) {
        const uint8_t *above = mask_row(mask, y > 0 ? y - 1 : 0), *row = mask_row(mask, y);
        const uint8_t *below = mask_row(mask, y < last_y ? y + 1 : last_y);
        uint8_t *restrict kept = mask_row(eroded, y);
        for (ptrdiff_t i = 0; i <= last; i++) column[i] = above[i] & row[i] & below[i];
        column[last] |= beyond;
        for (ptrdiff_t i = 0; i <= last; i++)
            kept[i] = column[i] & (uint8_t)(column[i] << 1 | column[i - 1] >> 7) &
                      (uint8_t)(column[i] >> 1 | column[i + 1] << 7);
        kept[last] &= (uint8_t)~beyond;
        memset(kept + last + 1, 0, (size_t)(bytes - last - 1));
    }
}
