/* Start-up code for a Cortex-M4F without any library, and an exit that QEMU and debuggers understand (semihosting). */
#include <stdint.h>

enum { SYS_EXIT = 0x18, EXIT_SUCCESS_CODE = 0x20026, EXIT_FAILURE_CODE = 0x20023 };

int main(void);

static void leave(uintptr_t reason) {
    for (;;) {
        register int r0 __asm__("r0") = SYS_EXIT;
        register uintptr_t r1 __asm__("r1") = reason;
        __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    }
}

/* Of the linker script. */
extern uint32_t data_in_flash[], data_start[], data_end[], bss_start[], bss_end[];
extern char stack_top[];

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
    leave(main() ? EXIT_FAILURE_CODE : EXIT_SUCCESS_CODE);
}

static void fault(void) {
    leave(EXIT_FAILURE_CODE);
}

/* ISO C has no conversion from a function to void *. */
union vector {
    const void *address;
    void (*handler)(void);
};

__attribute__((section(".vectors"), used)) static const union vector vectors[] = {
    {.address = stack_top}, {.handler = reset}, {.handler = fault}, {.handler = fault},
};
