/* The checks of the interface on a Cortex-M4F in QEMU (mps2-an386), without any library. */
#include <stdint.h>

#include "interface.h"

enum { SYS_OPEN = 1, SYS_WRITE = 5 };

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

int main(void) {
    return check_interface(say) != 0;
}
