/* Checks of the C interface, the same on a host and on a microcontroller: no library is needed. */
#ifndef INTERFACE_H
#define INTERFACE_H

/* Makes every check; tells each failure, and at the end a hash of all results, to `say`. Returns the number of failures. */
int check_interface(void (*say)(const char *text));

#endif
