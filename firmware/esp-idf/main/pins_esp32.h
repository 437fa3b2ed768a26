/* Classic ESP32 (WROOM-32). It has 22 pins that can drive an LED: 0 2 4 5 12..19 21 22 23 25 26 27 32 33 and the
 * console's 1 (TX) and 3 (RX); 6..11 are the flash, 34..39 are inputs only. 20 remain beside the console on the USB
 * connector, so the default map leaves out Gray bit 14 (-1): the visible count then wraps every 2^14 periods (65.5 s).
 *
 * With GOF_CONSOLE_ON_34 the console receives on the input-only pin 34 (an external USB-serial adapter: its TX to 34,
 * its RX to 1; nothing connected to the USB socket while running, its chip drives pin 3), and pin 3 drives bit 14.
 *
 * Strapping pins: 0 must be high and 12 low while the chip resets, 2 low or open to enter the bootloader. LED drivers
 * with pull-downs satisfy 2 and 12; pin 0 needs a driver that does not pull it down (a MOSFET gate with no pull-down).
 * WROVER modules use 16 and 17 for PSRAM: not supported. */
#ifdef GOF_CONSOLE_ON_34
#define GOF_GRAY_14 3
#else
#define GOF_GRAY_14 (-1)
#endif
#define GOF_PINS                                                                                                  \
    {                                                                                                             \
        4, 13, 14, 16, 17,                                                        /* strips 0..4 */               \
        18, 19, 21, 22, 23, 25, 26, 27, 32, 33, 15, 5, 2, 12, GOF_GRAY_14,        /* Gray bits 0..14 */           \
        0                                                                         /* disambiguation */            \
    }
