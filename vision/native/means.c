/* Adaptive threshold by running box sums, and erosion. Means equal cv2.blur with its default border. */
#include "search.h"

#include <string.h>

enum { LARGE_WINDOW_PX = 21, PART_PX = 5 };

/* Return the index of `at` within 0..length-1, mirrored at the ends without repeating them. */
static int32_t mirrored(int32_t at, int32_t length) {
    if (length == 1) return 0;
    const int32_t period = 2 * (length - 1);
    at %= period;
    if (at < 0) at += period;
    return at < length ? at : period - at;
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

/* Means of the large window, from sums over parts of five columns that fit 16 bits. The sum of 21 columns does not.
 * Single precision is exact enough: sum / 441 differs from a half by 1 / 882 at least, the product's error is 3e-5. */
static void large_window_means(const uint16_t *restrict columns, const uint16_t *restrict parts,
                               uint8_t *restrict means, int32_t width) {
    const float share = 1.0f / (LARGE_WINDOW_PX * LARGE_WINDOW_PX);
    for (int32_t x = 0; x < width; x++) {
        const int32_t sum = parts[x] + parts[x + PART_PX] + parts[x + 2 * PART_PX] + parts[x + 3 * PART_PX] +
                            columns[x + 4 * PART_PX];
        means[x] = (uint8_t)(int32_t)((float)sum * share + 0.5f);
    }
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

/* Write the mean over a box around each pixel. Widths of 3, 5, 9 and 21 px are compiled. */
int box_mean(const uint8_t *image, int32_t width, int32_t height, int32_t window_px, uint8_t *means, Workspace *work) {
    if (window_px != 3 && window_px != 5 && window_px != 9 && window_px != LARGE_WINDOW_PX) return INVALID_PARAMETERS;
    const int32_t reach = window_px / 2;
    uint16_t *padded = work->column_sums, *columns = padded + reach;
    memset(columns, 0, (size_t)width * sizeof *columns);
    for (int32_t y = -reach; y <= reach; y++) add_row(columns, image + (ptrdiff_t)mirrored(y, height) * width, width);
    for (int32_t y = 0; y < height; y++) {
        for (int32_t x = 1; x <= reach; x++) {
            columns[-x] = columns[mirrored(-x, width)];
            columns[width - 1 + x] = columns[mirrored(width - 1 + x, width)];
        }
        row_means(padded, work->window_sums, width, window_px, means + (ptrdiff_t)y * width);
        const uint8_t *added = image + (ptrdiff_t)mirrored(y + reach + 1, height) * width;
        const uint8_t *removed = image + (ptrdiff_t)mirrored(y - reach, height) * width;
        replace_row(columns, added, removed, width);
    }
    return 0;
}

/* Sharpen by an unsharp mask: twice the smooth image less the wide mean, within 0 to 255. */
static void sharpen(const uint8_t *restrict smooth, const uint8_t *restrict wide, uint8_t *restrict sharp,
                    ptrdiff_t count) {
    for (ptrdiff_t at = 0; at < count; at++) {
        int16_t value = (int16_t)(2 * smooth[at] - wide[at]);
        value = value < 0 ? 0 : value;
        sharp[at] = (uint8_t)(value > 255 ? 255 : value);
    }
}

/* Write the pixels of a row that are darker than the larger of two means. */
void compare(const uint8_t *small, const uint8_t *large, const uint8_t *restrict sharp, uint8_t *restrict dark,
             int32_t width, int32_t darker) {
    for (int32_t x = 0; x < width; x++) {
        const uint8_t mean = small[x] > large[x] ? small[x] : large[x];
        dark[x] = (int16_t)(mean - sharp[x]) > (int16_t)darker ? DARK : 0;
    }
}

/* Write the pixels of the sharpened image that are darker than the larger of two local means. */
int threshold(const uint8_t *image, int32_t width, int32_t height, const SearchParameters *parameters,
              Workspace *work) {
    uint8_t *smooth = work->smooth, *wide = work->wide, *sharp = work->sharp;
    if (box_mean(image, width, height, parameters->sharpening_px, smooth, work)) return INVALID_PARAMETERS;
    if (box_mean(smooth, width, height, parameters->sharpening_px, wide, work)) return INVALID_PARAMETERS;
    if (box_mean(image, width, height, parameters->smoothing_px, smooth, work)) return INVALID_PARAMETERS;
    sharpen(smooth, wide, sharp, (ptrdiff_t)width * height);
    if (box_mean(sharp, width, height, parameters->small_window_px, smooth, work)) return INVALID_PARAMETERS;
    if (box_mean(sharp, width, height, parameters->large_window_px, wide, work)) return INVALID_PARAMETERS;
    for (int32_t y = 0; y < height; y++) {
        const ptrdiff_t at = (ptrdiff_t)y * width;
        compare(smooth + at, wide + at, sharp + at, mask_row(&work->dark, y), width, parameters->darker);
    }
    return 0;
}

/* Write a row of places at twice the size. */
static void double_row(const uint8_t *restrict places, uint16_t *restrict doubled, int32_t count) {
    for (int32_t x = 0; x < count; x++) doubled[x] = (uint16_t)(places[x] * 257u);
}

static void keep_row(uint8_t *restrict row, const uint8_t *restrict kept, int32_t width) {
    for (int32_t x = 0; x < width; x++) row[x] &= kept[x];
}

/* Clear the pixels outside of the places, a plane of half the size. scratch (width / 2,) is for work. */
void keep_places(Mask *mask, const uint8_t *places, uint16_t *scratch) {
    const int32_t half = mask->width / 2;
    for (int32_t y = 0; y < mask->height; y++) {
        if (y % 2 == 0) double_row(places + (ptrdiff_t)(y / 2) * half, scratch, half);
        keep_row(mask_row(mask, y), (const uint8_t *)scratch, mask->width);
    }
}

/* Keep the pixels whose eight neighbours are all dark. Neighbours outside of the image count as dark. */
void erode(const Mask *mask, const Mask *eroded, uint8_t *scratch) {
    const int32_t last_x = mask->width - 1, last_y = mask->height - 1;
    for (int32_t y = 0; y <= last_y; y++) {
        const uint8_t *restrict above = mask_row(mask, y > 0 ? y - 1 : 0);
        const uint8_t *restrict row = mask_row(mask, y);
        const uint8_t *restrict below = mask_row(mask, y < last_y ? y + 1 : last_y);
        uint8_t *restrict column = scratch + 1, *restrict kept = mask_row(eroded, y);
        for (int32_t x = 0; x <= last_x; x++) column[x] = above[x] & row[x] & below[x];
        column[-1] = column[0];
        column[last_x + 1] = column[last_x];
        for (int32_t x = 0; x <= last_x; x++) kept[x] = column[x - 1] & column[x] & column[x + 1];
    }
}
