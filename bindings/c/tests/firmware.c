/* The checks of the interface on a Cortex-M4F in QEMU (mps2-an386), without any library. */
#include <stdint.h>

#include "interface.h"

enum { SYS_OPEN = 1, SYS_WRITE = 5, SYS_EXIT = 0x18, EXIT_SUCCESS_CODE = 0x20026, EXIT_FAILURE_CODE = 0x20023 };

static int semihosting(int operation, const void *argument) {
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void say(const char *text) {
    static const char console[] = ":tt";
    static int output = -1;
    if (output < 0) {
        /* Mode 4, "w": the standard output. */
        const uintptr_t open[] = {(uintptr_t)console, 4, sizeof console - 1};
        output = semihosting(SYS_OPEN, open);
    }
    uintptr_t length = 0;
    while (text[length]) {
        ++length;
    }
    const uintptr_t write[] = {(uintptr_t)output, (uintptr_t)text, length};
    semihosting(SYS_WRITE, write);
}

static void leave(uintptr_t reason) {
    for (;;) {
        semihosting(SYS_EXIT, (const void *)reason);
    }
}

extern uint32_t data_in_flash[], data_start[], data_end[], bss_start[], bss_end[];

static void reset(void) {
    /* Full access to the coprocessors 10 and 11: the floating-point unit. */
    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20;
    __asm__ volatile("dsb\n\tisb");
    for (uint32_t *to = data_start, *from = data_in_flash; to < data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *word = bss_start; word < bss_end;) {
        *word++ = 0;
    }
    leave(check_interface(say) ? EXIT_FAILURE_CODE : EXIT_SUCCESS_CODE);
}

static void fault(void) {
    say("fault\n");
    leave(EXIT_FAILURE_CODE);
}

extern char stack_top[];

/* ISO C has no conversion from a function to void *. */
union vector {
    const void *address;
    void (*handler)(void);
};

__attribute__((section(".vectors"), used)) static const union vector vectors[] = {
    {.address = stack_top}, {.handler = reset}, {.handler = fault}, {.handler = fault},
};
