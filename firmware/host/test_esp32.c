/* The ESP32 layer itself on the host, against fake registers and a fake timer. Built once per chip. */
#include "../esp-idf/main/main.c"

#include <setjmp.h>
#include <string.h>

#include "check.h"

/* Pins that are not the board's: the layer must leave them alone. */
#define FOREIGN_LOW (1u << 20)
#define FOREIGN_HIGH (1u << 14)

static struct {
    uint32_t out_low, out_high, out_low_at_config, out_high_at_config;
    uint64_t outputs, stuck_low, alarm;
    gptimer_event_callbacks_t callbacks;
    bool running;
    uint32_t watched, watchdog_resets;
    uint8_t input[GOF_FRAME_MAX], reply[GOF_REPLY_MAX];
    size_t input_length, reply_length;
    void (*task)(void *);
    jmp_buf idle;
} idf;

void REG_WRITE(fake_register reg, uint32_t value) {
    switch (reg) {
    case GPIO_OUT_W1TS_REG: idf.out_low |= value; break;
    case GPIO_OUT_W1TC_REG: idf.out_low &= ~value; break;
    case GPIO_OUT1_W1TS_REG: idf.out_high |= value; break;
    case GPIO_OUT1_W1TC_REG: idf.out_high &= ~value; break;
    default: CHECK(!"an output register");
    }
}

uint32_t REG_READ(fake_register reg) {
    CHECK(reg == GPIO_IN_REG || reg == GPIO_IN1_REG);
    uint64_t levels = (((uint64_t)idf.out_high << 32) | idf.out_low) & ~idf.stuck_low;
    return (uint32_t)(reg == GPIO_IN_REG ? levels : levels >> 32);
}

esp_err_t gpio_config(const gpio_config_t *config) {
    idf.outputs = config->pin_bit_mask;
    idf.out_low_at_config = idf.out_low;
    idf.out_high_at_config = idf.out_high;
    return config->mode != GPIO_MODE_INPUT_OUTPUT;
}

esp_err_t gptimer_new_timer(const gptimer_config_t *config, gptimer_handle_t *handle) {
    *handle = NULL;
    return config->resolution_hz != 10000000u;
}
esp_err_t gptimer_register_event_callbacks(gptimer_handle_t t, const gptimer_event_callbacks_t *callbacks, void *context) {
    (void)t, (void)context;
    idf.callbacks = *callbacks;
    return 0;
}
esp_err_t gptimer_enable(gptimer_handle_t t) { (void)t; return 0; }
esp_err_t gptimer_set_raw_count(gptimer_handle_t t, uint64_t count) { (void)t; return count != 0; }
esp_err_t gptimer_set_alarm_action(gptimer_handle_t t, const gptimer_alarm_config_t *alarm) { (void)t; idf.alarm = alarm->alarm_count; return 0; }
esp_err_t gptimer_start(gptimer_handle_t t) { (void)t; esp_err_t twice = idf.running; idf.running = true; return twice; }
esp_err_t gptimer_stop(gptimer_handle_t t) { (void)t; esp_err_t idle = !idf.running; idf.running = false; return idle; }

void xTaskCreatePinnedToCore(void (*task)(void *), const char *name, uint32_t stack, void *argument, int priority, void *handle, int core) {
    (void)name, (void)stack, (void)argument, (void)priority, (void)handle;
    CHECK(core == 1);
    idf.task = task;
}
esp_err_t esp_task_wdt_add(void *task) { idf.watched++; return task != NULL; }
esp_err_t esp_task_wdt_reset(void) { idf.watchdog_resets++; return 0; }

/* Gives the waiting input once, then an empty read (the console's time-out), then leaves the endless loop. */
int fake_console_read(uint8_t *bytes, uint32_t size) {
    static bool timed_out;
    if (idf.input_length > 0u) {
        CHECK(idf.input_length <= size);
        memcpy(bytes, idf.input, idf.input_length);
        int length = (int)idf.input_length;
        idf.input_length = 0;
        timed_out = false;
        return length;
    }
    if (timed_out) longjmp(idf.idle, 1);
    timed_out = true;
    return 0;
}

void fake_console_write(const uint8_t *bytes, size_t size) {
    CHECK(idf.reply_length + size <= sizeof idf.reply);
    memcpy(idf.reply + idf.reply_length, bytes, size);
    idf.reply_length += size;
}

/* Let the task serve one request; returns the reply's status, its payload in `payload`. */
static int ask(uint8_t type, const uint8_t *body, size_t length, uint8_t payload[GOF_FRAME_MAX]) {
    uint8_t request[GOF_PAYLOAD_MAX] = {GOF_PROTOCOL_VERSION, 1, type};
    if (length > 0u) memcpy(request + 3, body, length);
    idf.input_length = gof_frame_encode(request, length + 3u, idf.input);
    idf.reply_length = 0;
    if (!setjmp(idf.idle)) idf.task(NULL);
    gof_reader reader;
    gof_reader_init(&reader);
    size_t got = 0;
    for (size_t i = 0; i < idf.reply_length; i++) got = gof_reader_push(&reader, idf.reply[i], payload);
    CHECK(got >= 4 && payload[2] == (type | 0x80));
    return payload[3];
}

static void check_shown(uint32_t lit) {
    uint32_t low, high;
    gof_app_levels(lit, &low, &high);
    CHECK(idf.out_low == (low | FOREIGN_LOW) && idf.out_high == (high | FOREIGN_HIGH));
}

static void test_pins_are_dark_before_they_become_outputs(void) {
    memset(&idf, 0, sizeof idf);
    idf.out_low = idf.out_high = 0xFFFFFFFFu; /* whatever the bootloader left */
    app_main();
    uint64_t mask = 0;
    for (uint32_t i = 0; i < GOF_OUTPUTS; i++) mask |= gof_port_pins[i] < 0 ? 0u : 1ull << gof_port_pins[i];
    uint64_t dark = ((uint64_t)idf.out_high_at_config << 32) | idf.out_low_at_config;
    CHECK(idf.outputs == mask && (dark & mask) == 0 && (dark | mask) == UINT64_MAX);
    idf.out_low = FOREIGN_LOW;
    idf.out_high = FOREIGN_HIGH;
}

static void test_the_task_answers_and_feeds_the_watchdog(void) {
    uint8_t payload[GOF_FRAME_MAX];
    CHECK(ask(GOF_IDENTIFY, NULL, 0, payload) == GOF_OK && memcmp(payload + 12, "gof-board " GOF_FIRMWARE_VERSION, 9) == 0);
    CHECK(idf.watched == 1 && idf.watchdog_resets == 2); /* after the request, and after a silent half second */
}

static void test_ticks_follow_the_pattern_and_late_ones_do_not_add_up(void) {
    uint8_t payload[GOF_FRAME_MAX], near_wrap[4] = {0xFF, 0x7F, 0, 0};
    CHECK(ask(GOF_ARM, near_wrap, 4, payload) == GOF_OK && ask(GOF_START, NULL, 0, payload) == GOF_OK && idf.running);
    for (uint32_t tick = 0; tick < 25; tick++) {
        check_shown(gof_pattern(0x7FFFu + tick / 10u, tick % 10u));
        CHECK(idf.alarm == (tick + 1u) * 4000ull); /* 400 us at 100 ns */
        gptimer_alarm_event_data_t event = {.count_value = idf.alarm + (tick == 7 ? 50u : 3u), .alarm_value = idf.alarm};
        CHECK(!idf.callbacks.on_alarm(NULL, &event, NULL));
    }
    CHECK(app.jitter.ticks == 25 && app.jitter.earliest_ns == 300 && app.jitter.latest_ns == 5000 && app_lock == 0);
    CHECK(ask(GOF_STOP, NULL, 0, payload) == GOF_OK && !idf.running);
    check_shown(0);
    CHECK(ask(GOF_STOP, NULL, 0, payload) == GOF_OK); /* stopping twice does no harm */
}

static void test_self_test_reads_the_pins(void) {
    uint8_t payload[GOF_FRAME_MAX];
    CHECK(ask(GOF_SELF_TEST, NULL, 0, payload) == GOF_OK && (payload[4] | payload[5] | payload[6]) == 0);
    idf.stuck_low = 1ull << gof_port_pins[3];
    CHECK(ask(GOF_SELF_TEST, NULL, 0, payload) == GOF_OK && payload[4] == 1 << 3);
    check_shown(0);
}

int main(void) {
    RUN(test_pins_are_dark_before_they_become_outputs);
    RUN(test_the_task_answers_and_feeds_the_watchdog);
    RUN(test_ticks_follow_the_pattern_and_late_ones_do_not_add_up);
    RUN(test_self_test_reads_the_pins);
    return 0;
}
