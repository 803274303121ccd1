"""power_plate.csv: largest errors over all grid points of q″ + D^(3/2) q + q = f with the solution t^power on equal steps of [0, 1],
by the Galerkin scheme of degree 3 on the nodes of Radau IIA 3, damped at them, with exact moments of the force. 50 digits, all sums dense.

    python power_plate.py > power_plate.csv

Matrix weights from values of (Δ(z)/h)^(3/2) on a circle of radius 10^(−40/L); moments of the first step in closed form, of the others by 50
Gauss points. mpmath 1.3, gmpy2.
"""
from mpmath import diag, eig, expjpi, gamma, matrix, mp, mpf, nstr, sqrt

mp.dps = 50
BETA = mpf(3) / 2
RUNS = [(64, ["2.05", "2.2", "2.5", "2.8", "3.5"]), (256, ["2.2", "2.5"])]
S6, STAGES = sqrt(mpf(6)), range(3)
A = [[(88 - 7 * S6) / 360, (296 - 169 * S6) / 1800, (-2 + 3 * S6) / 225],
     [(296 + 169 * S6) / 1800, (88 + 7 * S6) / 360, (-2 - 3 * S6) / 225],
     [(16 - S6) / 36, (16 + S6) / 36, mpf(1) / 9]]
B, C = A[2], [(4 - S6) / 10, (4 + S6) / 10, mpf(1)]
POINTS = [mpf(0), (1 - 1 / sqrt(mpf(5))) / 2, (1 + 1 / sqrt(mpf(5))) / 2, mpf(1)]


def shape(index):
    """Coefficients of the Lagrange polynomial of a control point, the constant first."""
    coefficients = [mpf(1)]
    for other, point in enumerate(POINTS):
        if other != index:
            scale = POINTS[index] - point
            shifted = [mpf(0)] + coefficients
            coefficients = [(high - point * low) / scale for high, low in zip(shifted, coefficients + [mpf(0)])]
    return coefficients


SHAPES = [shape(index) for index in range(4)]


def value(coefficients, x):
    return sum(a * x ** i for i, a in enumerate(coefficients))


def slope(coefficients, x):
    return sum(i * a * x ** (i - 1) for i, a in enumerate(coefficients) if i)


def gauss(count):
    """Nodes and weights on [0, 1]."""
    nodes, weights = [], []
    for index in range(count):
        x = mp.cos(mp.pi * (index + mpf(3) / 4) / (count + mpf(1) / 2))
        for _ in range(8):
            before, here = mpf(1), x
            for k in range(2, count + 1):
                before, here = here, ((2 * k - 1) * x * here - (k - 1) * before) / k
            derivative = count * (x * here - before) / (x * x - 1)
            x -= here / derivative
        nodes.append((1 + x) / 2)
        weights.append(1 / ((1 - x * x) * derivative ** 2))
    return nodes, weights


GAUSS = gauss(50)


def matrix_weights(count, h):
    size = 8 * count if count > 128 else 16 * count
    radius = mpf(10) ** (-mpf(40) / size)
    inverse = matrix(A) ** -1
    jump = inverse * matrix([1, 1, 1]) * matrix([B]) * inverse
    powers = []
    for place in range(size // 2 + 1):
        values, vectors = eig(inverse - radius * expjpi(mpf(2) * place / size) * jump)
        powers.append(vectors * diag([x ** BETA for x in values]) * vectors ** -1)
    roots = [expjpi(-mpf(2) * place / size) for place in range(size)]
    weights = []
    for n in range(count):
        sums = [[mpf(0)] * 3 for _ in STAGES]
        for place, power in enumerate(powers):
            root, twice = roots[place * n % size], 1 if place in (0, size // 2) else 2
            for i in STAGES:
                for j in STAGES:
                    sums[i][j] += twice * (power[i, j].real * root.real - power[i, j].imag * root.imag)
        scale = radius ** -n / size * h ** -BETA
        weights.append([[number * scale for number in row] for row in sums])
    return weights


def moments(power, step, h):
    """h ∫ ℓ_ν(τ) f((step + τ) h) dτ"""
    terms = [(power * (power - 1), power - 2), (gamma(power + 1) / gamma(power + 1 - BETA), power - BETA), (mpf(1), power)]
    found = [mpf(0)] * 4
    if step == 0:
        for factor, exponent in terms:
            for nu, coefficients in enumerate(SHAPES):
                found[nu] += factor * h ** exponent * sum(a / (exponent + i + 1) for i, a in enumerate(coefficients))
    else:
        for x, weight in zip(*GAUSS):
            force = sum(factor * ((step + x) * h) ** exponent for factor, exponent in terms)
            for nu, coefficients in enumerate(SHAPES):
                found[nu] += weight * force * value(coefficients, x)
    return [h * number for number in found]


def largest_errors(power, steps, weights):
    h = mpf(1) / steps
    at = [[value(coefficients, c) for coefficients in SHAPES] for c in C]
    slopes = [[slope(coefficients, c) / h for coefficients in SHAPES] for c in C]

    def entry(nu, mu):
        """∂²L_d less the damping's leading part."""
        action = h * sum(B[i] * (slopes[i][nu] * slopes[i][mu] - at[i][nu] * at[i][mu]) for i in STAGES)
        return action - h * sum(B[i] * at[i][nu] * weights[0][i][j] * at[j][mu] for i in STAGES for j in STAGES)

    full = [[entry(nu, mu) for mu in range(4)] for nu in range(4)]
    solver = matrix([[full[nu][mu] for mu in (1, 2, 3)] for nu in (0, 1, 2)]) ** -1
    q, p, stages, errors = mpf(0), mpf(0), [], [mpf(0), mpf(0)]
    for k in range(steps):
        past = [sum(weights[n][i][j] * stages[k - n][j] for n in range(1, k + 1) for j in STAGES) for i in STAGES]
        load = moments(power, k, h)
        known = [load[nu] - h * sum(B[i] * at[i][nu] * past[i] for i in STAGES) for nu in range(4)]
        right = [-known[nu] - full[nu][0] * q - (p if nu == 0 else 0) for nu in range(3)]
        nodes = [q, *(solver * matrix(right))]
        p = sum(full[3][mu] * nodes[mu] for mu in range(4)) + known[3]
        stages.append([sum(at[i][mu] * nodes[mu] for mu in range(4)) for i in STAGES])
        q, time = nodes[3], (k + 1) * h
        errors = [max(errors[0], abs(q - time ** power)), max(errors[1], abs(p - power * time ** (power - 1)))]
    return errors


print("power,steps,position,momentum")
for steps, powers in RUNS:
    weights = matrix_weights(steps, mpf(1) / steps)
    for power in powers:
        print(power, steps, *(nstr(error, 6, min_fixed=0, max_fixed=0) for error in largest_errors(mpf(power), steps, weights)), sep=",", flush=True)
