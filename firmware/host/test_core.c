/* Table tests of the core against the fake registers. Prints one line per test; exits 1 at the first failure. */
#include <string.h>

#include "check.h"
#include "fake_port.h"
#include "gof_app.h"

static uint32_t bits(uint32_t x) { uint32_t n = 0; for (; x; x &= x - 1u) n++; return n; }
static uint32_t gray_of(uint32_t lit) { return (lit >> GOF_GRAY_FIRST) & GOF_COUNT_MASK; }
static uint32_t binary(uint32_t gray) { for (uint32_t s = 1; s < 16; s <<= 1) gray ^= gray >> s; return gray & GOF_COUNT_MASK; }

/* Lit logical outputs as the registers show them. */
static uint32_t lit_now(void) {
    uint32_t lit = 0;
    for (uint32_t i = 0; i < GOF_OUTPUTS; i++) {
        uint32_t pin = (uint32_t)gof_port_pins[i];
        uint32_t level = ((pin < 32 ? fake.low : fake.high) >> (pin & 31u)) & 1u;
        lit |= (level ^ ((gof_port_active_low >> i) & 1u)) << i;
    }
    return lit;
}

static void test_first_period(void) {
    static const uint32_t strips[GOF_TICKS_PER_PERIOD] = {1, 1, 2, 2, 4, 4, 8, 8, 16, 16};
    static const uint32_t disambiguation[GOF_TICKS_PER_PERIOD] = {0, 0, 0, 0, 1, 1, 1, 1, 1, 1};
    for (uint32_t phase = 0; phase < GOF_TICKS_PER_PERIOD; phase++) {
        CHECK(gof_pattern(0, phase) == (strips[phase] | disambiguation[phase] << GOF_DISAMBIGUATION));
    }
    CHECK(gof_pattern(GOF_COUNT_MASK + 1u, GOF_TICKS_PER_PERIOD) == gof_pattern(0, 0));
}

static void test_one_gray_bit_changes_per_period_including_the_wrap(void) {
    for (uint32_t count = 0; count <= GOF_COUNT_MASK; count++) {
        uint32_t before = gray_of(gof_pattern(count, 9)), after = gray_of(gof_pattern(count + 1u, 0));
        CHECK(bits(before ^ after) == 1);
        CHECK(binary(before) == count);
        for (uint32_t phase = 1; phase < GOF_TICKS_PER_PERIOD; phase++) {
            CHECK(gray_of(gof_pattern(count, phase)) == before);
        }
    }
}

/* A picture across a change reads either count; the disambiguation LED, steady there, has the parity of the later one. */
static void test_disambiguation_resolves_every_straddling_read(void) {
    for (uint32_t count = 0; count <= GOF_COUNT_MASK; count++) {
        uint32_t before = gof_pattern(count, 9) >> GOF_DISAMBIGUATION, after = gof_pattern(count + 1u, 0) >> GOF_DISAMBIGUATION;
        CHECK(before == after);
        uint32_t later = (count + 1u) & GOF_COUNT_MASK;
        for (uint32_t read = count; read <= count + 1u; read++) {
            uint32_t c = read & GOF_COUNT_MASK;
            uint32_t resolved = (c & 1u) == before ? c : (c + 1u) & GOF_COUNT_MASK;
            CHECK(resolved == later);
        }
    }
}

static void test_power_on_is_dark(void) {
    gof_app app;
    fake_reset();
    fake.low = fake.high = 0xFFFFFFFFu;
    gof_app_init(&app);
    CHECK(lit_now() == 0 && fake.writes == 1 && app.board.state == GOF_STOPPED);
    gof_app_tick(&app, 0);
    CHECK(lit_now() == 0 && app.jitter.ticks == 0);
}

static uint8_t reply_payload[GOF_FRAME_MAX];

/* Send a request byte by byte; returns the reply's status, its body in reply_payload + 4. */
static int ask(gof_app *app, uint8_t type, const void *body, size_t length) {
    uint8_t payload[GOF_PAYLOAD_MAX] = {GOF_PROTOCOL_VERSION, 7, type}, frame[GOF_FRAME_MAX], reply[GOF_REPLY_MAX];
    if (length) memcpy(payload + 3, body, length);
    size_t n = gof_frame_encode(payload, length + 3, frame), got = 0;
    for (size_t i = 0; i < n; i++) got = gof_app_receive(app, frame[i], reply);
    CHECK(got > 0);
    static const char boot_text[] = "rst:0x1 (POWERON_RESET)\r\nentry 0x400805f0\r\n"; /* without a zero */
    gof_reader reader;
    gof_reader_init(&reader);
    for (size_t i = 0; i + 1u < sizeof boot_text; i++) gof_reader_push(&reader, (uint8_t)boot_text[i], reply_payload);
    size_t out = 0;
    for (size_t i = 0; i < got; i++) out = gof_reader_push(&reader, reply[i], reply_payload);
    CHECK(out >= 4 && reply_payload[0] == GOF_PROTOCOL_VERSION && reply_payload[1] == 7 && reply_payload[2] == (type | 0x80));
    return reply_payload[3];
}

static void test_running_follows_the_pattern_through_the_wrap(void) {
    gof_app app;
    fake_reset();
    gof_app_init(&app);
    uint8_t near_wrap[4] = {0xFE, 0x7F, 0, 0};
    CHECK(ask(&app, GOF_ARM, near_wrap, 4) == GOF_OK && lit_now() == gof_pattern(0x7FFE, 0) && fake.tick_us == 0);
    CHECK(ask(&app, GOF_START, NULL, 0) == GOF_OK && fake.tick_us == GOF_TICK_US_DEFAULT);
    for (uint32_t tick = 0; tick < 50; tick++) {
        CHECK(lit_now() == gof_pattern(0x7FFE + tick / 10, tick % 10));
        gof_app_tick(&app, tick % 2 ? 300 : -100);
    }
    CHECK(app.board.count == 3 && app.board.periods == 5);
    CHECK(app.jitter.ticks == 50 && app.jitter.earliest_ns == -100 && app.jitter.latest_ns == 300 && app.jitter.total_abs_ns == 25 * 400);
    CHECK(ask(&app, GOF_START, NULL, 0) == GOF_WRONG_STATE);
    CHECK(ask(&app, GOF_SET_TICK, near_wrap, 4) == GOF_WRONG_STATE);
    CHECK(ask(&app, GOF_STATUS, NULL, 0) == GOF_OK && reply_payload[4] == GOF_RUNNING && reply_payload[6] == 3);
    CHECK(ask(&app, GOF_STOP, NULL, 0) == GOF_OK && lit_now() == 0 && fake.tick_us == 0);
}

static void test_test_modes(void) {
    gof_app app;
    fake_reset();
    gof_app_init(&app);
    uint8_t on[2] = {GOF_TEST_ALL_ON, 0}, off[2] = {GOF_TEST_ALL_OFF, 0}, one[2] = {GOF_TEST_ONE, 20}, bad[2] = {GOF_TEST_ONE, 21};
    CHECK(ask(&app, GOF_SHOW_TEST, on, 2) == GOF_OK && lit_now() == GOF_ALL_OUTPUTS);
    CHECK(ask(&app, GOF_SHOW_TEST, off, 2) == GOF_OK && lit_now() == 0);
    CHECK(ask(&app, GOF_SHOW_TEST, one, 2) == GOF_OK && lit_now() == 1u << 20);
    CHECK(ask(&app, GOF_SHOW_TEST, bad, 2) == GOF_BAD_ARGUMENT);
    CHECK(ask(&app, GOF_START, NULL, 0) == GOF_WRONG_STATE);
}

static void test_self_test_names_stuck_and_bridged_outputs(void) {
    gof_app app;
    fake_reset();
    gof_app_init(&app);
    CHECK(ask(&app, GOF_SELF_TEST, NULL, 0) == GOF_OK && reply_payload[4] == 0 && reply_payload[5] == 0 && reply_payload[6] == 0);
    fake.stuck_high = 1ull << gof_port_pins[3];
    fake.stuck_low = 1ull << gof_port_pins[20];
    CHECK(ask(&app, GOF_SELF_TEST, NULL, 0) == GOF_OK && reply_payload[4] == 1 << 3 && reply_payload[6] == 1 << 4);
    fake_reset();
    fake.bridge_a = gof_port_pins[1];
    fake.bridge_b = gof_port_pins[2];
    CHECK(ask(&app, GOF_SELF_TEST, NULL, 0) == GOF_OK && reply_payload[4] == (1 << 1 | 1 << 2));
    CHECK(lit_now() == 0);
}

static void test_bad_requests(void) {
    gof_app app;
    fake_reset();
    gof_app_init(&app);
    uint8_t zero[4] = {0, 0, 0, 0}, big[4] = {0, 0x80, 0, 0}, reply[GOF_REPLY_MAX], frame[GOF_FRAME_MAX];
    CHECK(ask(&app, 99, NULL, 0) == GOF_UNKNOWN);
    CHECK(ask(&app, GOF_SET_TICK, zero, 4) == GOF_BAD_ARGUMENT && ask(&app, GOF_SET_TICK, zero, 3) == GOF_BAD_ARGUMENT);
    CHECK(ask(&app, GOF_ARM, big, 4) == GOF_BAD_ARGUMENT);
    uint8_t foreign[3] = {9, 1, GOF_IDENTIFY};
    size_t n = gof_frame_encode(foreign, 3, frame), got = 0;
    for (size_t i = 0; i < n; i++) got = gof_app_receive(&app, frame[i], reply);
    CHECK(got > 0);
    gof_reader reader;
    gof_reader_init(&reader);
    for (size_t i = 0; i < got; i++) gof_reader_push(&reader, reply[i], reply_payload);
    CHECK(reply_payload[3] == GOF_WRONG_VERSION);
}

/* After any noise the next whole frame is understood (at worst the one after a line-clearing zero). */
static void test_noise_never_breaks_the_line(void) {
    gof_app app;
    fake_reset();
    gof_app_init(&app);
    uint8_t reply[GOF_REPLY_MAX];
    uint32_t random = 12345;
    for (int round = 0; round < 2000; round++) {
        for (int i = 0; i < 300; i++) {
            random = random * 1664525u + 1013904223u;
            gof_app_receive(&app, (uint8_t)(random >> 24), reply);
        }
        gof_app_receive(&app, 0, reply);
        gof_port_timer_stop();
        CHECK(ask(&app, GOF_IDENTIFY, NULL, 0) == GOF_OK && reply_payload[4] == GOF_STRIPS && reply_payload[5] == GOF_GRAY_BITS);
    }
    CHECK(app.reader.bad_frames > 1000 && fake.locked == 0);
}

static void test_frames_round_trip_and_every_bit_error_is_caught(void) {
    uint8_t payload[GOF_PAYLOAD_MAX + 1], frame[GOF_FRAME_MAX], out[GOF_FRAME_MAX];
    memset(payload, 0, sizeof payload);
    CHECK(gof_crc16((const uint8_t *)"123456789", 9) == 0x29B1);
    CHECK(gof_frame_encode(payload, GOF_PAYLOAD_MAX + 1, frame) == 0);
    for (size_t length = 1; length <= GOF_PAYLOAD_MAX; length++) {
        for (size_t i = 0; i < length; i++) payload[i] = (uint8_t)(i * length % 5 ? i * 37 : 0);
        size_t n = gof_frame_encode(payload, length, frame);
        CHECK(n == length + 4 && frame[n - 1] == 0 && memchr(frame, 0, n - 1) == NULL);
        gof_reader reader;
        gof_reader_init(&reader);
        size_t got = 0;
        for (size_t i = 0; i < n; i++) got = gof_reader_push(&reader, frame[i], out);
        CHECK(got == length && memcmp(out, payload, length) == 0);
        for (size_t bit = 0; bit < (n - 1) * 8; bit++) {
            frame[bit / 8] ^= (uint8_t)(1u << bit % 8);
            for (size_t i = 0; i < n; i++) CHECK(gof_reader_push(&reader, frame[i], out) == 0);
            frame[bit / 8] ^= (uint8_t)(1u << bit % 8);
        }
    }
}

static void test_pins_are_distinct(void) {
    uint64_t used = 0;
    for (uint32_t i = 0; i < GOF_OUTPUTS; i++) {
        CHECK(gof_port_pins[i] >= 0 && gof_port_pins[i] < 49 && !((used >> gof_port_pins[i]) & 1u));
        used |= 1ull << gof_port_pins[i];
    }
}

int main(void) {
    RUN(test_first_period);
    RUN(test_one_gray_bit_changes_per_period_including_the_wrap);
    RUN(test_disambiguation_resolves_every_straddling_read);
    RUN(test_power_on_is_dark);
    RUN(test_running_follows_the_pattern_through_the_wrap);
    RUN(test_test_modes);
    RUN(test_self_test_names_stuck_and_bridged_outputs);
    RUN(test_bad_requests);
    RUN(test_noise_never_breaks_the_line);
    RUN(test_frames_round_trip_and_every_bit_error_is_caught);
    RUN(test_pins_are_distinct);
    return 0;
}
