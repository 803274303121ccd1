"""Grünwald–Letnikov weights w_n = Γ(n − β) / (Γ(−β) n!) at large n, 40 digits, for long_weights.csv.

The exponent is the binary double nearest to the decimal one printed. Two ways that must agree to 30 digits: log-gamma
functions, and the product of w_0 … by Pochhammer's symbol. mpmath 1.3.
"""
import mpmath as mp

mp.mp.dps = 60
EXPONENTS = [0.3, 0.5, 0.9, 0.999, 1.001, 1.1, 1.5, 1.9, -0.5, -0.9, 0.001, 1.999]
LAGS = [1, 5, 8, 9, 17, 25, 33, 64, 100, 1000, 12345, 10**5, 10**6, 10**7, 3 * 10**7, 10**8]

print("exponent,n,weight")
for exponent in EXPONENTS:
    beta = mp.mpf(exponent)
    for n in LAGS:
        by_log = mp.exp(mp.loggamma(n - beta) - mp.loggamma(n + 1)) / mp.gamma(-beta) if n > beta else None
        by_symbol = mp.rf(-beta, n) / mp.factorial(n)
        if by_log is not None:
            assert abs(by_log / by_symbol - 1) < mp.mpf(10) ** -30, (exponent, n)
        print(f"{exponent!r},{n},{mp.nstr(by_symbol, 25)}")
