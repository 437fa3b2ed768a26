/* ESP32 layer (ESP-IDF 5.3 or newer): hardware timer, register-level pin writes, serial console, watchdog. */
#include "driver/gpio.h"
#include "driver/gptimer.h"
#include "esp_attr.h"
#include "esp_err.h"
#include "esp_rom_sys.h"
#include "esp_task_wdt.h"
#include "freertos/FreeRTOS.h"
#include "freertos/task.h"
#include "gof_app.h"
#include "sdkconfig.h"
#include "soc/gpio_reg.h"
#include "soc/soc.h"

#if CONFIG_IDF_TARGET_ESP32S3
#include "driver/usb_serial_jtag.h"
#include "pins_esp32s3.h"
const char gof_port_name[] = "esp32s3";
#else
#include "driver/uart.h"
#include "pins_esp32.h"
const char gof_port_name[] = "esp32";
#ifdef GOF_CONSOLE_ON_34
#define CONSOLE_RX 34
#else
#define CONSOLE_RX 3
#endif
#endif

/* Set for LED drivers that light at a low level: -DGOF_ACTIVE_LOW=0x1F for all five strips, for example. */
#ifndef GOF_ACTIVE_LOW
#define GOF_ACTIVE_LOW 0u
#endif

#define TIMER_HZ 10000000u /* 100 ns per count */
#define NS_PER_COUNT 100

DRAM_ATTR const int8_t gof_port_pins[GOF_OUTPUTS] = GOF_PINS;
DRAM_ATTR const uint32_t gof_port_active_low = GOF_ACTIVE_LOW;

static gof_app app;
static gptimer_handle_t timer;
static portMUX_TYPE app_lock = portMUX_INITIALIZER_UNLOCKED;
static DRAM_ATTR uint32_t mask_low, mask_high;
static volatile uint64_t alarm_at;
static volatile uint64_t alarm_step;

/* Set and clear registers: other pins stay as they are, and no read-modify-write. The two words of one bank are written
 * within two bus cycles (about 25 ns); the strips share a bank, so their edges coincide to that. */
void IRAM_ATTR gof_port_write(uint32_t low, uint32_t high) {
    REG_WRITE(GPIO_OUT_W1TS_REG, low & mask_low);
    REG_WRITE(GPIO_OUT_W1TC_REG, ~low & mask_low);
    REG_WRITE(GPIO_OUT1_W1TS_REG, high & mask_high);
    REG_WRITE(GPIO_OUT1_W1TC_REG, ~high & mask_high);
}

void gof_port_read(uint32_t *low, uint32_t *high) {
    esp_rom_delay_us(20); /* LED driver gates settle */
    *low = REG_READ(GPIO_IN_REG) & mask_low;
    *high = REG_READ(GPIO_IN1_REG) & mask_high;
}

void gof_port_lock(void) { portENTER_CRITICAL(&app_lock); }
void gof_port_unlock(void) { portEXIT_CRITICAL(&app_lock); }

static bool IRAM_ATTR on_alarm(gptimer_handle_t t, const gptimer_alarm_event_data_t *event, void *context) {
    (void)context;
    portENTER_CRITICAL_ISR(&app_lock);
    gof_app_tick(&app, (int32_t)((int64_t)(event->count_value - alarm_at) * NS_PER_COUNT));
    portEXIT_CRITICAL_ISR(&app_lock);
    /* Absolute alarm times: a late interrupt delays one tick, never the ones after it. */
    alarm_at += alarm_step;
    gptimer_alarm_config_t alarm = {.alarm_count = alarm_at};
    gptimer_set_alarm_action(t, &alarm);
    return false;
}

void gof_port_timer_start(uint32_t tick_us) {
    alarm_step = (uint64_t)tick_us * (TIMER_HZ / 1000000u);
    alarm_at = alarm_step;
    gptimer_alarm_config_t alarm = {.alarm_count = alarm_at};
    ESP_ERROR_CHECK(gptimer_set_raw_count(timer, 0));
    ESP_ERROR_CHECK(gptimer_set_alarm_action(timer, &alarm));
    ESP_ERROR_CHECK(gptimer_start(timer));
}

void gof_port_timer_stop(void) { gptimer_stop(timer); /* already stopped: an error code, nothing to do */ }

static void open_pins(void) {
    for (uint32_t i = 0; i < GOF_OUTPUTS; i++) {
        if (gof_port_pins[i] < 0) {
            continue;
        }
        uint32_t pin = (uint32_t)gof_port_pins[i];
        *(pin < 32u ? &mask_low : &mask_high) |= 1u << (pin & 31u);
    }
    gof_app_init(&app); /* dark levels are in the output registers before a pin becomes an output */
    uint64_t pins = ((uint64_t)mask_high << 32) | mask_low;
    gpio_config_t config = {.pin_bit_mask = pins, .mode = GPIO_MODE_INPUT_OUTPUT};
    ESP_ERROR_CHECK(gpio_config(&config));
}

static void open_timer(void) {
    gptimer_config_t config = {
        .clk_src = GPTIMER_CLK_SRC_DEFAULT, .direction = GPTIMER_COUNT_UP, .resolution_hz = TIMER_HZ, .intr_priority = 3};
    gptimer_event_callbacks_t callbacks = {.on_alarm = on_alarm};
    ESP_ERROR_CHECK(gptimer_new_timer(&config, &timer));
    ESP_ERROR_CHECK(gptimer_register_event_callbacks(timer, &callbacks, NULL));
    ESP_ERROR_CHECK(gptimer_enable(timer));
}

#if CONFIG_IDF_TARGET_ESP32S3
static void console_open(void) {
    usb_serial_jtag_driver_config_t config = USB_SERIAL_JTAG_DRIVER_CONFIG_DEFAULT();
    ESP_ERROR_CHECK(usb_serial_jtag_driver_install(&config));
}
static int console_read(uint8_t *bytes, uint32_t size) { return usb_serial_jtag_read_bytes(bytes, size, pdMS_TO_TICKS(500)); }
static void console_write(const uint8_t *bytes, size_t size) { usb_serial_jtag_write_bytes(bytes, size, pdMS_TO_TICKS(100)); }
#else
static void console_open(void) {
    uart_config_t config = {.baud_rate = 115200, .data_bits = UART_DATA_8_BITS, .stop_bits = UART_STOP_BITS_1};
    ESP_ERROR_CHECK(uart_driver_install(UART_NUM_0, 512, 512, 0, NULL, 0));
    ESP_ERROR_CHECK(uart_param_config(UART_NUM_0, &config));
    ESP_ERROR_CHECK(uart_set_pin(UART_NUM_0, 1, CONSOLE_RX, UART_PIN_NO_CHANGE, UART_PIN_NO_CHANGE));
}
static int console_read(uint8_t *bytes, uint32_t size) { return uart_read_bytes(UART_NUM_0, bytes, size, pdMS_TO_TICKS(500)); }
static void console_write(const uint8_t *bytes, size_t size) { uart_write_bytes(UART_NUM_0, bytes, size); }
#endif

/* Owns core 1: installs the timer there (its interrupt runs on the core that enabled it), then serves the console. */
static void serve(void *unused) {
    (void)unused;
    open_timer();
    console_open();
    ESP_ERROR_CHECK(esp_task_wdt_add(NULL));
    for (;;) {
        uint8_t bytes[64], reply[GOF_REPLY_MAX];
        int count = console_read(bytes, sizeof bytes);
        for (int i = 0; i < count; i++) {
            size_t length = gof_app_receive(&app, bytes[i], reply);
            if (length > 0u) {
                console_write(reply, length);
            }
        }
        esp_task_wdt_reset();
    }
}

void app_main(void) {
    open_pins();
    xTaskCreatePinnedToCore(serve, "board", 4096, NULL, 5, NULL, 1);
}
