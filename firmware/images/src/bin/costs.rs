//! Prints the costs of memories and steppers: instructions per step, bytes, stack.
#![no_std]
#![no_main]

use core::borrow::Borrow;
use core::fmt::{Display, Write};
use core::hint::black_box;

use controllers::band::{BAND_DERIVATIVE, BAND_INTEGRAL, BandLaw, band_with};
use controllers::fractional::{
    FRACTIONAL_DERIVATIVE, FRACTIONAL_INTEGRAL, FractionalLaw, fractional_with, new_fractional,
};
use controllers::integer::{IntegerLaw, integer_with};
use controllers::whole::{WHOLE_LAW, new_whole};
use fvi_core::{
    BdfOrder, Coefficients, Damping, DampingTerm, Derivative, ExponentialPid, ExponentialSum, Fixed,
    FixedDirect, FractionalIntegral, FractionalOperator, FractionalPid, Galerkin, Integrator, Kernel, Mass,
    Memory, NoForce, NodeGalerkin, Overflow, ParameterError, PidLaw, Quadratic, RungeKutta, Scheme, Start,
    System, Tiled, VariableStepMemory, monic_bdf_table_f32,
};
use images::spread::Spread;
use images::stack::used_by;
use images::{Counter, Output, Refused, image};
use nalgebra::SVector;
use scenarios::oustaloup::Oustaloup;
use scenarios::tables::axis::{AXIS_DERIVATIVE, AXIS_INTEGRAL, AxisLaw, axis_law, axis_with};
use scenarios::tables::{DAMPING, ENDLESS, JITTER_DAMPING};

/// Number of steps measured; two tiles, so that every position in a tile occurs.
const MEASURED: usize = 16;

static WEIGHTS: [f32; 1025] = monic_bdf_table_f32(BdfOrder::GRUNWALD_LETNIKOV, 0.5);

/// Number of products of a step of the exponential sum (`PRODUCTS`), and bytes of its table.
const PRODUCTS: usize = DAMPING.head.len() + DAMPING.exponentials.len();
const TABLE_BYTES: usize = 4 * PRODUCTS;

struct Bench<'a> {
    out: &'a mut Output,
    counter: Counter,
}

impl Bench<'_> {
    /// `ram`: bytes of the state; `table`: bytes that may be stored in flash.
    fn row(
        &mut self,
        name: impl Display,
        steps: Spread,
        products: usize,
        ram: usize,
        table: usize,
        stack: usize,
    ) {
        let (mean, worst) = (steps.mean(), steps.worst());
        // Errors are ignored: without a debugger there is no other output.
        let _ = writeln!(self.out, "{name},{mean:.1},{worst},{products},{ram},{table},{stack}");
    }

    /// Measures a memory filled to its final size: `next_term` and `push` together.
    #[inline(always)]
    fn memory<M: Memory<f32>>(
        &mut self,
        name: impl Display + Copy,
        mut memory: M,
        products: usize,
        fill: usize,
    ) {
        let mut sample = [0.0; 2];
        let sample = &mut sample[..memory.channels()];
        for k in 0..fill {
            sample.fill((k % 7) as f32 - 3.0);
            let _ = memory.push(sample);
        }
        let (mut terms, mut pushes, mut steps) = (Spread::default(), Spread::default(), Spread::default());
        let mut term = [0.0; 2];
        let term = &mut term[..memory.channels()];
        for k in 0..MEASURED {
            sample.fill(k as f32);
            let asked = self.counter.count(|| {
                let _ = black_box(&mut memory).next_term(term);
                black_box(&*term);
            });
            let pushed = self.counter.count(|| {
                let _ = black_box(&mut memory).push(black_box(&*sample));
            });
            terms.add(asked);
            pushes.add(pushed);
            steps.add(asked + pushed);
        }
        let stack = used_by(|| {
            let _ = black_box(&mut memory).next_term(term);
            let _ = black_box(&mut memory).push(black_box(&*sample));
        });
        let (ram, products) = (size_of_val(&memory), products * memory.channels());
        let table = memory.bytes() - ram;
        self.row(format_args!("{name}: term"), terms, products, ram, table, stack);
        self.row(format_args!("{name}: push"), pushes, products, ram, table, stack);
        self.row(name, steps, products, ram, table, stack);
    }

    fn direct<const C: usize, const H: usize>(&mut self) -> Result<(), Refused> {
        let memory = FixedDirect::<f32, C, H>::short_memory(&WEIGHTS[..=H], 1.0).map_err(|_| Refused)?;
        // One and a half revolutions, so that the history is in two slices.
        self.memory(format_args!("direct {H} x {C}"), memory, H, H + H / 2);
        Ok(())
    }

    fn tiled<const C: usize, const B: usize>(&mut self) -> Result<(), Refused> {
        let memory = Tiled::<f32, C, B>::new(&WEIGHTS, 1.0, Overflow::Forget).map_err(|_| Refused)?;
        self.memory(format_args!("tiled {} x {C}", 8 * (B - 1)), memory, 8 * (B - 1), 12 * B);
        Ok(())
    }

    #[inline(always)]
    fn stepper<const N: usize, S: Scheme<f32, Fixed<N>>, D: Damping<f32, Fixed<N>>>(
        &mut self,
        name: &str,
        scheme: S,
        damping: D,
        fill: usize,
        table: usize,
    ) -> Result<(), Refused> {
        let system = System {
            mass: Mass::diagonal([1.0; N]).map_err(|_| Refused)?,
            potential: Quadratic::diagonal([4.0; N]).map_err(|_| Refused)?,
            force: NoForce,
        };
        let (start, rest) = (SVector::repeat(1.0), SVector::zeros());
        let mut integrator = Integrator::builder(system, scheme, 1e-3)
            .damping(damping)
            .position(start)
            .momentum(rest)
            .build()
            .map_err(|_| Refused)?;
        for _ in 0..fill {
            integrator.step(&rest).map_err(|_| Refused)?;
        }
        let mut steps = Spread::default();
        for _ in 0..MEASURED {
            let taken = self.counter.count(|| {
                let _ = black_box(black_box(&mut integrator).step(black_box(&rest)));
            });
            steps.add(taken);
        }
        let stack = used_by(|| {
            let _ = black_box(black_box(&mut integrator).step(black_box(&rest)));
        });
        self.row(format_args!("stepper: {name} x {N}"), steps, 0, size_of_val(&integrator), table, stack);
        Ok(())
    }

    fn term<const N: usize, M: Memory<f32>>(memory: M) -> Result<DampingTerm<f32, Fixed<N>, M>, Refused> {
        let rho = Coefficients::Diagonal(SVector::repeat(0.1));
        DampingTerm::new(Kernel::given(0.5).map_err(|_| Refused)?, rho, Derivative::Caputo, memory)
            .map_err(|_| Refused)
    }

    fn coordinates<const N: usize, const STATE: usize>(&mut self) -> Result<(), Refused> {
        let main = Galerkin::low_order(0.5).map_err(|_| Refused)?;
        let nodes = NodeGalerkin::new(main);
        self.stepper::<N, _, ()>("no damping", main, (), 20, 0)?;
        let sum = || ExponentialSum::new(DAMPING, 1.0, N, [0.0; STATE]).map_err(|_| Refused);
        self.memory(format_args!("exponential sum x {N}"), sum()?, PRODUCTS, 20);
        self.stepper::<N, _, _>("exponential sum", main, Self::term(sum()?)?, 20, TABLE_BYTES)?;
        self.stepper::<N, _, _>("exponential sum at the node", nodes, Self::term(sum()?)?, 20, TABLE_BYTES)?;
        let ring = FixedDirect::<f32, N, 256>::short_memory(&WEIGHTS[..=256], 31.6).map_err(|_| Refused)?;
        self.stepper::<N, _, _>("direct 256", main, Self::term(ring)?, 300, 4 * 257)
    }

    /// Measures the memory for steps of any length, with equal and with varying steps.
    fn any_step(&mut self) -> Result<(), Refused> {
        const STATE: usize = JITTER_DAMPING.state_len(1, 1);
        const RATES: usize = JITTER_DAMPING.rates.len();
        let method = RungeKutta::<1>::radau_iia().map_err(|_| Refused)?;
        for (name, late) in [("of one length", 0.0), ("of new lengths", 1e-4)] {
            let memory = VariableStepMemory::new(&method, JITTER_DAMPING, 1, [0.0f32; STATE]);
            let mut memory = memory.map_err(|_| Refused)?;
            let (mut steps, mut term) = (Spread::default(), [0.0]);
            memory.begin_step(0.01).map_err(|_| Refused)?;
            let mut step = |memory: &mut VariableStepMemory<f32, 1, _, _>, k: usize| {
                let memory = black_box(memory);
                let _ = memory.begin_step(black_box(0.01 + late * k as f32));
                let _ = memory.next_term(black_box(&mut term));
                let _ = memory.push(black_box(&[k as f32]));
            };
            for k in 0..MEASURED {
                steps.add(self.counter.count(|| step(&mut memory, k)));
            }
            let stack = used_by(|| step(&mut memory, MEASURED));
            let (ram, products) = (size_of_val(&memory), 3 * RATES);
            let table = memory.bytes() - ram;
            self.row(format_args!("any step x 1: {name}"), steps, products, ram, table, stack);
        }
        Ok(())
    }

    fn oustaloup<const S: usize>(&mut self) {
        let mut filter = Oustaloup::<f32, S>::new(0.5, 1e-5, 1e3, 1e-3);
        let mut steps = Spread::default();
        for k in 0..MEASURED {
            steps.add(self.counter.count(|| {
                black_box(black_box(&mut filter).push(black_box(k as f32)));
            }));
        }
        let stack = used_by(|| {
            black_box(black_box(&mut filter).push(black_box(1.0)));
        });
        self.row(format_args!("Oustaloup {S}"), steps, 3 * S, size_of_val(&filter), 0, stack);
    }

    /// Measures a table without a horizon, whose slowest sums are stored in three parts.
    fn endless(&mut self) -> Result<(), Refused> {
        const STATE: usize = ENDLESS.state_len(1);
        let memory = ExponentialSum::new(ENDLESS, 1.0, 1, [0.0f32; STATE]).map_err(|_| Refused)?;
        self.memory(
            "endless exponential sum x 1",
            memory,
            ENDLESS.head.len() + ENDLESS.exponentials.len(),
            20,
        );
        Ok(())
    }

    /// Measures I^0.5 as the integral of D^0.5.
    fn integral(&mut self) -> Result<(), Refused> {
        const STATE: usize = DAMPING.state_len(1);
        let kernel = Kernel::bdf(BdfOrder::GRUNWALD_LETNIKOV, 0.5, 1e-3).map_err(|_| Refused)?;
        let memory = kernel.exponential_sum::<f32, _, _>(DAMPING, 1, [0.0; STATE]).map_err(|_| Refused)?;
        let mut integral = FractionalIntegral::new(&kernel, memory).map_err(|_| Refused)?;
        let mut steps = Spread::default();
        for k in 0..MEASURED {
            let taken = self.counter.count(|| {
                let _ = black_box(black_box(&mut integral).push(black_box(k as f32)));
            });
            steps.add(taken);
        }
        let stack = used_by(|| {
            let _ = black_box(black_box(&mut integral).push(black_box(1.0)));
        });
        let ram = size_of_val(&integral);
        self.row("integral: exponential sum x 1", steps, PRODUCTS, ram, TABLE_BYTES, stack);
        Ok(())
    }

    /// Measures a fractional PID controller with limits, back-calculation and a filter; half of its ticks are
    /// at a limit. Its law is shared by reference.
    fn controller(&mut self) -> Result<(), Refused> {
        let law = axis_law().map_err(|_| Refused)?;
        let kernel = law.integral_kernel().map_err(|_| Refused)?;
        let integral = kernel.exponential_sum(AXIS_INTEGRAL, 1, [0.0; AXIS_INTEGRAL.state_len(1)]);
        let kernel = law.derivative_kernel().map_err(|_| Refused)?;
        let derivative = kernel.exponential_sum(AXIS_DERIVATIVE, 1, [0.0; AXIS_DERIVATIVE.state_len(1)]);
        let (integral, derivative) = (integral.map_err(|_| Refused)?, derivative.map_err(|_| Refused)?);
        let mut pid: ExponentialPid<'_, f32, _, _, &PidLaw<f32>> =
            FractionalPid::new(&law, integral, derivative).map_err(|_| Refused)?;
        let mut steps = Spread::default();
        for k in 0..MEASURED {
            let setpoint = if k % 16 < 8 { 10.0 } else { 0.01 };
            let taken = self.counter.count(|| {
                let _ = black_box(black_box(&mut pid).tick(black_box(setpoint), black_box(0.0)));
            });
            steps.add(taken);
        }
        let stack = used_by(|| {
            let _ = black_box(black_box(&mut pid).tick(black_box(1.0), black_box(0.0)));
        });
        let products = [&AXIS_INTEGRAL, &AXIS_DERIVATIVE]
            .iter()
            .map(|table| table.head.len() + table.exponentials.len())
            .sum();
        let ram = size_of_val(&pid);
        self.row("controller: exponential sums x 2", steps, products, ram, 4 * products, stack);
        Ok(())
    }

    /// Measures a generated controller with limits, back-calculation and a filter; half of its ticks are at
    /// a limit. Every controller in a function of its own, in which no other one takes registers.
    #[inline(never)]
    fn generated<I: Memory<f32>, D: Memory<f32>, L: Borrow<PidLaw<f32>>>(
        &mut self,
        name: &str,
        mut pid: FractionalPid<f32, I, D, L>,
        products: usize,
    ) {
        let mut steps = Spread::default();
        for k in 0..MEASURED {
            let setpoint = if k % 16 < 8 { 10.0 } else { 0.01 };
            let taken = self.counter.count(|| {
                let _ = black_box(black_box(&mut pid).tick(black_box(setpoint), black_box(0.0)));
            });
            steps.add(taken);
        }
        let stack = used_by(|| {
            let _ = black_box(black_box(&mut pid).tick(black_box(1.0), black_box(0.0)));
        });
        self.row(name, steps, products, size_of_val(&pid), 4 * products, stack);
    }

    /// Measures what a start of a generated controller takes, checks of its law included.
    fn set_up<C>(&mut self, name: &str, start: impl Fn() -> Result<C, ParameterError>) {
        let mut starts = Spread::default();
        starts.add(self.counter.count(|| {
            let _ = black_box(black_box(&start)());
        }));
        let stack = used_by(|| {
            let _ = black_box(black_box(&start)());
        });
        self.row(format_args!("set-up of a {name}"), starts, 0, size_of::<C>(), 0, stack);
    }

    /// Measures the controllers of the package `controllers`.
    fn controllers(&mut self) -> Result<(), Refused> {
        let products = [FRACTIONAL_INTEGRAL, FRACTIONAL_DERIVATIVE]
            .iter()
            .map(|table| table.head.len() + table.exponentials.len())
            .sum();
        self.set_up("generated controller: orders 1 with a fixed law", || integer_with(IntegerLaw));
        self.set_up("generated controller: endless with a fixed law", || fractional_with(FractionalLaw));
        self.set_up("generated controller: endless with a law that changes", new_fractional);
        let integer = integer_with(IntegerLaw).map_err(|_| Refused)?;
        self.generated("generated controller: orders 1 with a fixed law", integer, 2);
        let fixed = fractional_with(FractionalLaw).map_err(|_| Refused)?;
        self.generated("generated controller: endless with a fixed law", fixed, products);
        let changing = new_fractional().map_err(|_| Refused)?;
        self.generated("generated controller: endless with a law that changes", changing, products);
        let fixed = axis_with(AxisLaw).map_err(|_| Refused)?;
        let products = [AXIS_INTEGRAL, AXIS_DERIVATIVE]
            .iter()
            .map(|table| table.head.len() + table.exponentials.len())
            .sum();
        self.generated("generated controller: 10^8 ticks with a fixed law", fixed, products);
        let fixed = band_with(BandLaw).map_err(|_| Refused)?;
        let products = [BAND_INTEGRAL, BAND_DERIVATIVE]
            .iter()
            .map(|table| table.head.len() + table.exponentials.len())
            .sum();
        self.generated("generated controller: 1 % over five decades", fixed, products);
        self.whole()
    }

    /// Measures the last controller in whole numbers, on the same inputs.
    fn whole(&mut self) -> Result<(), Refused> {
        let mut pid = new_whole().map_err(|_| Refused)?;
        let mut steps = Spread::default();
        for k in 0..MEASURED {
            let setpoint = if k % 16 < 8 { 100_000 } else { 100 };
            steps.add(self.counter.count(|| {
                let _ = black_box(black_box(&mut pid).tick(black_box(setpoint), black_box(0)));
            }));
        }
        let stack = used_by(|| {
            let _ = black_box(black_box(&mut pid).tick(black_box(10_000), black_box(0)));
        });
        let [integral, derivative] = [WHOLE_LAW.integral, WHOLE_LAW.derivative];
        let products = [integral, derivative].iter().map(|part| part.head.len() + 2 * part.terms.len()).sum();
        let table = size_of_val(&WHOLE_LAW)
            + size_of_val(integral.head)
            + size_of_val(integral.terms)
            + size_of_val(derivative.head)
            + size_of_val(derivative.terms);
        let name = "generated controller: 1 % over five decades in whole numbers";
        self.row(name, steps, products, size_of_val(&pid), table, stack);
        Ok(())
    }

    fn operator(&mut self) -> Result<(), Refused> {
        const STATE: usize = DAMPING.state_len(1);
        let memory = ExponentialSum::new(DAMPING, 1.0, 1, [0.0f32; STATE]).map_err(|_| Refused)?;
        let mut operator = FractionalOperator::new(memory, Start::Caputo).map_err(|_| Refused)?;
        let mut steps = Spread::default();
        for k in 0..MEASURED {
            let taken = self.counter.count(|| {
                let _ = black_box(black_box(&mut operator).push(black_box(k as f32)));
            });
            steps.add(taken);
        }
        let stack = used_by(|| {
            let _ = black_box(black_box(&mut operator).push(black_box(1.0)));
        });
        self.row(
            "operator: exponential sum x 1",
            steps,
            PRODUCTS,
            size_of_val(&operator),
            TABLE_BYTES,
            stack,
        );
        Ok(())
    }
}

image!(|out| {
    let unit = if cfg!(feature = "cycles") { "cycles" } else { "instructions" };
    let _ = writeln!(out, "name,{unit},worst,products,ram,table,stack");
    let mut bench = Bench { out, counter: Counter::new().ok_or(Refused)? };
    bench.direct::<1, 32>()?;
    bench.direct::<1, 64>()?;
    bench.direct::<1, 128>()?;
    bench.direct::<1, 160>()?;
    bench.direct::<1, 256>()?;
    bench.direct::<1, 1024>()?;
    bench.direct::<2, 256>()?;
    bench.tiled::<1, 17>()?;
    bench.tiled::<1, 33>()?;
    bench.tiled::<1, 129>()?;
    bench.tiled::<2, 33>()?;
    bench.operator()?;
    bench.integral()?;
    bench.controller()?;
    bench.controllers()?;
    bench.endless()?;
    bench.any_step()?;
    bench.oustaloup::<15>();
    bench.oustaloup::<31>();
    bench.oustaloup::<75>();
    bench.coordinates::<1, { DAMPING.state_len(1) }>()?;
    bench.coordinates::<2, { DAMPING.state_len(2) }>()
});
