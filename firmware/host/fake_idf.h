/* As much of ESP-IDF as the ESP32 layer uses, with registers and timer in memory, so that main.c compiles and runs on the
 * host. Included before main.c; the headers it asks for are empty files (see the Makefile). */
#ifndef FAKE_IDF_H
#define FAKE_IDF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define IRAM_ATTR
#define DRAM_ATTR
typedef int esp_err_t;
#define ESP_ERROR_CHECK(call) ((call) ? abort() : (void)0)

typedef enum { GPIO_OUT_W1TS_REG, GPIO_OUT_W1TC_REG, GPIO_OUT1_W1TS_REG, GPIO_OUT1_W1TC_REG, GPIO_IN_REG, GPIO_IN1_REG } fake_register;
void REG_WRITE(fake_register reg, uint32_t value);
uint32_t REG_READ(fake_register reg);
static inline void esp_rom_delay_us(uint32_t us) { (void)us; }

typedef enum { GPIO_MODE_INPUT_OUTPUT = 3 } gpio_mode_t;
typedef struct { uint64_t pin_bit_mask; gpio_mode_t mode; } gpio_config_t;
esp_err_t gpio_config(const gpio_config_t *config);

typedef struct fake_timer *gptimer_handle_t;
typedef struct { uint64_t count_value, alarm_value; } gptimer_alarm_event_data_t;
typedef struct { uint64_t alarm_count; } gptimer_alarm_config_t;
typedef struct { int clk_src, direction; uint32_t resolution_hz; int intr_priority; } gptimer_config_t;
typedef struct { bool (*on_alarm)(gptimer_handle_t, const gptimer_alarm_event_data_t *, void *); } gptimer_event_callbacks_t;
enum { GPTIMER_CLK_SRC_DEFAULT, GPTIMER_COUNT_UP };
esp_err_t gptimer_new_timer(const gptimer_config_t *config, gptimer_handle_t *timer);
esp_err_t gptimer_register_event_callbacks(gptimer_handle_t timer, const gptimer_event_callbacks_t *callbacks, void *context);
esp_err_t gptimer_enable(gptimer_handle_t timer);
esp_err_t gptimer_set_raw_count(gptimer_handle_t timer, uint64_t count);
esp_err_t gptimer_set_alarm_action(gptimer_handle_t timer, const gptimer_alarm_config_t *alarm);
esp_err_t gptimer_start(gptimer_handle_t timer);
esp_err_t gptimer_stop(gptimer_handle_t timer);

typedef int portMUX_TYPE;
#define portMUX_INITIALIZER_UNLOCKED 0
#define portENTER_CRITICAL(lock) (++*(lock))
#define portEXIT_CRITICAL(lock) (--*(lock))
#define portENTER_CRITICAL_ISR portENTER_CRITICAL
#define portEXIT_CRITICAL_ISR portEXIT_CRITICAL
#define pdMS_TO_TICKS(ms) ((uint32_t)(ms))
void xTaskCreatePinnedToCore(void (*task)(void *), const char *name, uint32_t stack, void *argument, int priority, void *handle, int core);
esp_err_t esp_task_wdt_add(void *task);
esp_err_t esp_task_wdt_reset(void);

/* Both consoles end in these two. */
int fake_console_read(uint8_t *bytes, uint32_t size);
void fake_console_write(const uint8_t *bytes, size_t size);

typedef struct { int unused; } usb_serial_jtag_driver_config_t;
#define USB_SERIAL_JTAG_DRIVER_CONFIG_DEFAULT() {0}
static inline esp_err_t usb_serial_jtag_driver_install(usb_serial_jtag_driver_config_t *config) { (void)config; return 0; }
#define usb_serial_jtag_read_bytes(bytes, size, ticks) fake_console_read(bytes, size)
#define usb_serial_jtag_write_bytes(bytes, size, ticks) fake_console_write(bytes, size)

typedef struct { int baud_rate, data_bits, stop_bits; } uart_config_t;
enum { UART_NUM_0, UART_DATA_8_BITS, UART_STOP_BITS_1, UART_PIN_NO_CHANGE = -1 };
static inline esp_err_t uart_driver_install(int port, int rx, int tx, int queue, void *handle, int flags) {
    (void)port, (void)rx, (void)tx, (void)queue, (void)handle, (void)flags;
    return 0;
}
static inline esp_err_t uart_param_config(int port, const uart_config_t *config) { (void)port, (void)config; return 0; }
static inline esp_err_t uart_set_pin(int port, int tx, int rx, int rts, int cts) { (void)port, (void)tx, (void)rx, (void)rts, (void)cts; return 0; }
#define uart_read_bytes(port, bytes, size, ticks) fake_console_read(bytes, size)
#define uart_write_bytes(port, bytes, size) fake_console_write(bytes, size)

#endif
