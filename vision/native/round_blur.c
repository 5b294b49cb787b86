/* Columns of the model under blur that is round, or nearly so, in the marker.
 *
 * For blur that is round in the image only, the marker's anisotropy and keystone add terms, which are taken to first order
 * (vision/photometric/fitting/design_matrix.py).
 */
#include "columns.h"

/* Numbers of a marker in single precision. */
typedef struct {
    float cells, half, per_side, per_cell, x_rate, y_rate, half_card, ground_level, texture_square;
    float keystone_x, keystone_y, anisotropy_x, anisotropy_y;
    int has_ground;
} Look;

static Look look_of(const Marker *marker, int32_t n, float texture_square) {
    return (Look){
        .cells = (float)n,
        .half = (float)n / 2,
        .per_side = (float)(1 / marker->sigma),
        .per_cell = (float)(1 / (n * marker->sigma)),
        .x_rate = (float)(1 / (marker->sigma * marker->x_stretch)),
        .y_rate = (float)(1 / (marker->sigma * marker->y_stretch)),
        .half_card = (float)marker->half_card,
        .ground_level = (float)marker->ground_level,
        .texture_square = texture_square,
        .keystone_x = (float)marker->keystone.re,
        .keystone_y = (float)marker->keystone.im,
        .anisotropy_x = (float)marker->anisotropy.re,
        .anisotropy_y = (float)marker->anisotropy.im,
        .has_ground = marker->half_card < INFINITY,
    };
}

/* F = Σ_r Σ_c E_r B_rc E_c, and σ F_x, σ F_y, σ² F_xx, σ² F_xy and σ² F_yy. */
typedef struct { Floats f, x, y, xx, xy, yy; } Blurred;

INLINE Blurred blurred_at(int count, const CellBits *bits, const Edges *across, const Edges *down) {
    Floats above[MAX_ORDERS], here[MAX_ORDERS];
    sum_row(count, 3, cells_of(bits, across, down, 0), across, above);
    Blurred sums = {above[0], above[1], {0}, above[2], {0}, {0}};
    for (int e = 0; e < count; e++) {
        sum_row(count, 3, cells_of(bits, across, down, e + 1), across, here);
        const Floats change = here[0] - above[0], change_x = here[1] - above[1], change_xx = here[2] - above[2];
        sums.f += down->orders[0][e] * change;
        sums.x += down->orders[0][e] * change_x;
        sums.xx += down->orders[0][e] * change_xx;
        sums.y += down->orders[1][e] * change;
        sums.xy += down->orders[1][e] * change_x;
        sums.yy += down->orders[2][e] * change;
        for (int k = 0; k < 3; k++) above[k] = here[k];
    }
    return sums;
}

/* Return T and its derivatives at pixels, of blur that is round in the image only, without the ground's weight. */
INLINE Shown shown_of(const Blurred *sums, const Look *look, Floats x, Floats y) {
    const float kx = look->keystone_x, ky = look->keystone_y;
    const Floats log_blur = -(sums->xx + sums->yy), along = kx * x + ky * y;
    Floats white = 1.0f - sums->f;
    white += (sums->xx - sums->yy) * (look->anisotropy_x - 0.5f * (kx * x - ky * y));
    white += 2.0f * sums->xy * (look->anisotropy_y - 0.5f * (ky * x + kx * y));
    white += 1.5f * along * log_blur;
    return (Shown){white, -sums->x * look->per_side, -sums->y * look->per_side, log_blur, {{0}, all(1.0f)}};
}

/* Return the same for a marker without a card; `beyond` are the sums of the ground around it, without the weight. */
INLINE Shown shown_without_card(const Blurred *sums, const Blurred *beyond, const Look *look, Floats x, Floats y) {
    const float level = look->ground_level;
    const Floats share = 1.0f - shown_of(beyond, look, x, y).level;
    const Blurred both = {sums->f - level * beyond->f,   sums->x - level * beyond->x,   sums->y - level * beyond->y,
                          sums->xx - level * beyond->xx, sums->xy - level * beyond->xy, sums->yy - level * beyond->yy};
    Shown shown = shown_of(&both, look, x, y);
    shown.ground = weighted_ground(share, look->texture_square);
    return shown;
}

/* Fill in the blocks of one marker. `count` edges are in reach along each axis. */
INLINE void fill_marker(int count, int is_all, const Scene *scene, const MarkerBlocks *given, int64_t k) {
    const Marker *marker = scene->markers + k;
    const Look look = look_of(marker, scene->n, scene->texture_square);
    const int64_t sides = scene->n + 2;
    const CellBits bits = bits_of(scene->cells + k * sides * sides, scene->n), ground = ground_bits(scene->n);
    Edges across, down;
    for (int64_t at = given->bounds[k] * BLOCK_PX; at < given->bounds[k + 1] * BLOCK_PX; at += LANES) {
        const Part part = part_at(scene, given, k, at / BLOCK_PX, at % BLOCK_PX);
        const Floats x = part.x, y = part.y, per_cell = all(look.per_cell);
        compute_edges(count, is_all, 3, scene->n, x * look.cells + look.half, per_cell, &across);
        compute_edges(count, is_all, 3, scene->n, y * look.cells + look.half, per_cell, &down);
        const Blurred sums = blurred_at(count, &bits, &across, &down);
        Shown shown = shown_of(&sums, &look, x, y);
        if (marker->is_bare) {
            const Blurred beyond = blurred_at(count, &ground, &across, &down);
            shown = shown_without_card(&sums, &beyond, &look, x, y);
        } else if (look.has_ground) {
            const Floats x_rate = all(look.x_rate), y_rate = all(look.y_rate);
            shown.ground = ground_at(x, y, look.half_card, x_rate, y_rate, look.texture_square);
        }
        shown.slope_x *= shown.ground.weight;
        shown.slope_y *= shown.ground.weight;
        write_columns(&shown, &part, marker, given->columns);
    }
}

/* Fill in the weighted columns of the model, and the pixels less MIDDLE_GREY. Returns 0 or an error. */
int32_t fill_round(const Scene *scene, const MarkerBlocks *given) {
    if (!are_valid(scene, given)) return FIT_INVALID_SIZE;
    for (int64_t k = 0; k < given->count; k++) {
        const double reach = REACH_SIGMAS * scene->n * scene->markers[k].sigma; /* in cells */
        if (reach <= 1) fill_marker(2, 0, scene, given, k);
        else if (reach <= 2) fill_marker(4, 0, scene, given, k);
        else if (reach <= 3) fill_marker(6, 0, scene, given, k);
        else if (reach <= 4) fill_marker(8, 0, scene, given, k);
        else fill_marker(scene->n + 1, 1, scene, given, k);
    }
    return 0;
}
