/* Where markers will be in the next image, and how they moved (vision/photometric/tracks.py). */
#include "follow.h"

static Complex exponential(Complex a) {
    const double size = exp(a.re);
    return (Complex){size * cos(a.im), size * sin(a.im)};
}

static Complex logarithm(Complex a) { return (Complex){log(magnitude(a)), atan2(a.im, a.re)}; }

/* Return the time since a marker was seen; 1 s for each image if times do not increase. */
static double elapsed_s(const Track *track, double time_s) {
    return time_s > track->time_s ? time_s - track->time_s : 1.0 + (double)track->missed;
}

/* Return the factor by which a similarity turns and grows within a time, s; the growth is limited. */
static Complex turn_within(Complex log_rate, double elapsed_s, double max_log_growth) {
    const Complex sum = scaled(log_rate, elapsed_s);
    return exponential((Complex){fmax(-max_log_growth, fmin(sum.re, max_log_growth)), sum.im});
}

/* Predict a marker's homography: similarities go on turning and growing, and centres on an arc go on with them. */
void predict(const Track *track, double time_s, double max_log_growth, Homography *place) {
    const Homography *last = &track->homography;
    const double elapsed = elapsed_s(track, time_s);
    const Complex turn = turn_within(track->similarity_log_rate, elapsed, max_log_growth);
    const Complex velocity = track->on_arc ? times(track->velocity, turn) : track->velocity;
    *place = (Homography){
        plus(last->center, scaled(velocity, elapsed)),
        times(last->similarity, turn),
        times(last->anisotropy, conjugate(turn)),
        last->perspective,
    };
}

/* Return by how much a marker's corners moved at most, in its sides. */
double shift_sides(const Homography *before, const Homography *after) {
    return corner_shift_px(before, after) / side_px(before);
}

static int is_inside(Complex point, int64_t height, int64_t width) {
    const double u = fabs(point.re - (double)(width - 1) / 2), v = fabs(point.im - (double)(height - 1) / 2);
    return u < (double)width / 2 && v < (double)height / 2;
}

/* List the tracks whose predicted centres are in view, and which should be seen: those that are whole in view, and those
 * whose prediction lies so far away that it may be wrong. */
void find_in_view(const FollowRequest *given, FollowResults *results) {
    results->here = 0;
    for (int64_t k = 0; k < given->count; k++) {
        const Track *track = given->tracks + k;
        Homography *start = results->starts + results->here;
        predict(track, given->time_s, given->constants->max_log_growth, start);
        int whole = 1;
        for (int corner = 0; corner < 4; corner++)
            whole &= is_inside(image_of(start, SQUARE_CORNERS[corner]), given->height, given->width);
        const int away = shift_sides(&track->homography, start) > given->constants->reach_sides;
        results->should_be_seen[k] = track->missed == 0 && (whole || away);
        if (is_inside(start->center, given->height, given->width)) results->rows[results->here++] = k;
    }
}

/* Return a track after an image that shows its marker. One far from its prediction is another place, and stands still. */
static Track seen_track(const Track *last, double time_s, const FollowConstants *constants, const Fit *fit,
                        double sigma_px) {
    const Homography *at = &fit->homography;
    Track track = {.id = last->id, .time_s = time_s, .homography = *at, .on_arc = 1, .sigma_px = sigma_px,
                   .around = fit->around};
    Homography place;
    predict(last, time_s, constants->max_log_growth, &place);
    if (!(shift_sides(&place, at) <= constants->reach_sides)) return track;
    const double elapsed = elapsed_s(last, time_s);
    track.velocity = scaled(minus(at->center, last->homography.center), 1 / elapsed);
    track.similarity_log_rate = scaled(logarithm(over(at->similarity, last->homography.similarity)), 1 / elapsed);
    const Complex turned = times(last->velocity, turn_within(last->similarity_log_rate, elapsed, constants->max_log_growth));
    track.on_arc = magnitude(minus(track.velocity, turned)) <= magnitude(minus(track.velocity, last->velocity));
    return track;
}

/* Write the tracks after an image in which all markers in view were found, under blurs sigmas_px (here,). */
void update_tracks(const FollowRequest *given, const double *sigmas_px, FollowResults *results) {
    int64_t next = 0;
    results->track_count = 0;
    for (int64_t k = 0; k < given->count; k++) {
        const Track *last = given->tracks + k;
        if (next < results->here && results->rows[next] == k) {
            results->tracks[results->track_count++] = seen_track(
                last, given->time_s, given->constants, results->fits + next, sigmas_px[next]);
            next++;
        } else if (last->missed < given->constants->max_missed) {
            Track *kept = results->tracks + results->track_count++;
            *kept = *last;
            kept->missed++;
        }
    }
}
