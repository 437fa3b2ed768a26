#include "gof_app.h"

#include <string.h>

void gof_app_levels(uint32_t lit, uint32_t *low, uint32_t *high) {
    uint32_t level = lit ^ gof_port_active_low;
    uint32_t words[2] = {0u, 0u};
    for (uint32_t i = 0; i < GOF_OUTPUTS; i++) {
        if (gof_port_pins[i] >= 0 && ((level >> i) & 1u)) {
            uint32_t pin = (uint32_t)gof_port_pins[i];
            words[pin >> 5] |= 1u << (pin & 31u);
        }
    }
    *low = words[0];
    *high = words[1];
}

static void show_now(const gof_app *app) {
    uint32_t low, high;
    gof_app_levels(gof_board_lit(&app->board), &low, &high);
    gof_port_write(low, high);
}

static void prepare_next(gof_app *app) {
    gof_board next = app->board;
    gof_board_step(&next);
    gof_app_levels(gof_board_lit(&next), &app->next_low, &app->next_high);
}

void gof_app_init(gof_app *app) {
    gof_board_init(&app->board);
    gof_reader_init(&app->reader);
    memset(&app->jitter, 0, sizeof app->jitter);
    app->tick_us = GOF_TICK_US_DEFAULT;
    app->wired = 0u;
    for (uint32_t i = 0; i < GOF_OUTPUTS; i++) {
        app->wired |= gof_port_pins[i] >= 0 ? 1u << i : 0u;
    }
    app->next_low = app->next_high = 0u;
    show_now(app); /* power-on pattern: every LED dark, whatever its polarity */
}

void gof_app_tick(gof_app *app, int32_t late_ns) {
    if (app->board.state != GOF_RUNNING) {
        return;
    }
    gof_port_write(app->next_low, app->next_high);
    gof_board_step(&app->board);
    prepare_next(app);
    gof_jitter *jitter = &app->jitter;
    if (jitter->ticks == 0u || late_ns < jitter->earliest_ns) {
        jitter->earliest_ns = late_ns;
    }
    if (jitter->ticks == 0u || late_ns > jitter->latest_ns) {
        jitter->latest_ns = late_ns;
    }
    jitter->total_abs_ns += late_ns < 0 ? 0u - (uint32_t)late_ns : (uint32_t)late_ns;
    jitter->ticks++;
}

static uint32_t get_u32(const uint8_t *p) {
    return (uint32_t)p[0] | ((uint32_t)p[1] << 8) | ((uint32_t)p[2] << 16) | ((uint32_t)p[3] << 24);
}

static size_t put_u32(uint8_t *p, uint32_t value) {
    for (int i = 0; i < 4; i++) {
        p[i] = (uint8_t)(value >> (8 * i));
    }
    return 4;
}

static size_t put_identity(const gof_app *app, uint8_t *p) {
    size_t n = 0;
    p[n++] = GOF_STRIPS;
    p[n++] = GOF_GRAY_BITS;
    p[n++] = GOF_TICKS_PER_SLOT;
    p[n++] = GOF_TICKS_PER_PERIOD;
    n += put_u32(p + n, app->wired);
    static const char text[] = "gof-board " GOF_FIRMWARE_VERSION " ";
    memcpy(p + n, text, sizeof text - 1u);
    n += sizeof text - 1u;
    for (const char *c = gof_port_name; *c && n < GOF_PAYLOAD_MAX - 4u; c++) {
        p[n++] = (uint8_t)*c;
    }
    return n;
}

static size_t put_status(const gof_app *app, uint8_t *p) {
    /* A consistent copy: the interrupt must not step between two fields. */
    gof_port_lock();
    gof_board board = app->board;
    gof_jitter jitter = app->jitter;
    gof_port_unlock();
    size_t n = 0;
    p[n++] = (uint8_t)board.state;
    p[n++] = (uint8_t)board.phase;
    n += put_u32(p + n, board.count);
    n += put_u32(p + n, board.periods);
    n += put_u32(p + n, app->tick_us);
    n += put_u32(p + n, jitter.ticks);
    n += put_u32(p + n, (uint32_t)jitter.earliest_ns);
    n += put_u32(p + n, (uint32_t)jitter.latest_ns);
    n += put_u32(p + n, jitter.ticks ? (uint32_t)(jitter.total_abs_ns / jitter.ticks) : 0u);
    n += put_u32(p + n, app->reader.bad_frames);
    return n;
}

static uint32_t level_of(uint32_t output, uint32_t low, uint32_t high) {
    uint32_t pin = (uint32_t)gof_port_pins[output];
    return ((pin < 32u ? low : high) >> (pin & 31u)) & 1u;
}

/* Drive each output high with all others low and read the pins back; returns the outputs that ever read wrong: stuck,
 * or dragged along by a bridge to another one. Leaves the board stopped. */
static uint32_t self_test(gof_app *app) {
    uint32_t bad = 0u;
    for (uint32_t i = 0; i < GOF_OUTPUTS; i++) {
        uint32_t low, high, read_low, read_high;
        gof_app_levels((1u << i) ^ gof_port_active_low, &low, &high);
        gof_port_write(low, high);
        gof_port_read(&read_low, &read_high);
        for (uint32_t k = 0; k < GOF_OUTPUTS; k++) {
            if (((app->wired >> k) & 1u) && level_of(k, low, high) != level_of(k, read_low, read_high)) {
                bad |= 1u << k;
            }
        }
    }
    gof_board_stop(&app->board);
    show_now(app);
    return bad;
}

static uint8_t run_command(gof_app *app, uint8_t type, const uint8_t *body, size_t length, uint8_t *out, size_t *out_len) {
    switch (type) {
    case GOF_IDENTIFY:
        *out_len = put_identity(app, out);
        return GOF_OK;
    case GOF_STATUS:
        *out_len = put_status(app, out);
        return GOF_OK;
    case GOF_SET_TICK: {
        if (length != 4u) {
            return GOF_BAD_ARGUMENT;
        }
        uint32_t tick_us = get_u32(body);
        if (tick_us < GOF_TICK_US_MIN || tick_us > GOF_TICK_US_MAX) {
            return GOF_BAD_ARGUMENT;
        }
        if (app->board.state == GOF_RUNNING) {
            return GOF_WRONG_STATE;
        }
        app->tick_us = tick_us;
        return GOF_OK;
    }
    case GOF_ARM:
        if (length != 4u || get_u32(body) > GOF_COUNT_MASK) {
            return GOF_BAD_ARGUMENT;
        }
        if (app->board.state == GOF_RUNNING) {
            return GOF_WRONG_STATE;
        }
        gof_board_arm(&app->board, get_u32(body));
        show_now(app);
        return GOF_OK;
    case GOF_START:
        if (!gof_board_start(&app->board)) {
            return GOF_WRONG_STATE;
        }
        memset(&app->jitter, 0, sizeof app->jitter);
        prepare_next(app);
        show_now(app);
        gof_port_timer_start(app->tick_us);
        return GOF_OK;
    case GOF_STOP:
        gof_port_timer_stop();
        gof_board_stop(&app->board);
        show_now(app);
        return GOF_OK;
    case GOF_SHOW_TEST:
        if (length != 2u) {
            return GOF_BAD_ARGUMENT;
        }
        if (app->board.state == GOF_RUNNING) {
            return GOF_WRONG_STATE;
        }
        if (!gof_board_test(&app->board, (gof_test)body[0], body[1])) {
            return GOF_BAD_ARGUMENT;
        }
        show_now(app);
        return GOF_OK;
    case GOF_SELF_TEST:
        if (app->board.state == GOF_RUNNING) {
            return GOF_WRONG_STATE;
        }
        *out_len = put_u32(out, self_test(app));
        return GOF_OK;
    default:
        return GOF_UNKNOWN;
    }
}

size_t gof_app_receive(gof_app *app, uint8_t byte, uint8_t reply[GOF_REPLY_MAX]) {
    uint8_t request[GOF_FRAME_MAX];
    size_t length = gof_reader_push(&app->reader, byte, request);
    if (length == 0u) {
        return 0;
    }
    /* request: version, sequence, type, body...   reply: version, sequence, type | 0x80, status, body... */
    uint8_t out[GOF_PAYLOAD_MAX];
    size_t out_len = 0;
    if (length < 3u) {
        app->reader.bad_frames++;
        return 0;
    }
    out[0] = GOF_PROTOCOL_VERSION;
    out[1] = request[1];
    out[2] = (uint8_t)(request[2] | 0x80u);
    out[3] = request[0] == GOF_PROTOCOL_VERSION
                 ? run_command(app, request[2], request + 3, length - 3u, out + 4, &out_len)
                 : (uint8_t)GOF_WRONG_VERSION;
    reply[0] = 0u;
    return 1u + gof_frame_encode(out, out_len + 4u, reply + 1);
}
