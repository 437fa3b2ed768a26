/* ESP32-S3 (default board). Strips, Gray bits 0..14, disambiguation LED.
 * Left free: 0, 3, 45, 46 strapping; 19, 20 USB console; 26..32 flash; 33..37 octal PSRAM; 43, 44 UART0. */
#define GOF_PINS                                                                                                  \
    {                                                                                                             \
        1, 2, 4, 5, 6,                                          /* strips 0..4 */                                 \
        7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 21, 38, 39, /* Gray bits 0..14 */                            \
        40                                                      /* disambiguation */                              \
    }
