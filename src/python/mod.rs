//! The face towards Python: convert, release the GIL, call the core, map the error. One file a module of the core.
//!
//! Shapes, defaults and documentation are in `python/radiosity/`; nothing here is public to users.

mod accuracy;
mod assembly;
mod block;
mod convert;
mod direct;
mod error;
mod form_factor;
mod hierarchy;
mod instant;
mod mapped;
mod remote;
mod render;
mod reserve;
mod run;
mod scene;
mod solve;

use pyo3::prelude::*;

// Free-threaded Python is not promised: nobody has tested it.
#[pymodule(gil_used = true)]
mod _core {
    #[pymodule_init]
    fn init(_module: &super::Bound<'_, super::PyModule>) -> super::PyResult<()> {
        // Calls that copy arrays come before the first work. Where there is no room yet, work says so.
        super::reserve::hold();
        Ok(())
    }

    #[pymodule_export]
    use super::accuracy::{assess, forecast_scene, solve_scene};
    #[pymodule_export]
    use super::assembly::FormFactors;
    #[pymodule_export]
    use super::block::Block;
    #[pymodule_export]
    use super::direct::{Lights, direct_irradiance, sky_coefficients};
    #[pymodule_export]
    use super::form_factor::{form_factor, pair_form_factors};
    #[pymodule_export]
    use super::hierarchy::solve_hierarchical;
    #[pymodule_export]
    use super::instant::{instant, places, virtual_lights};
    #[pymodule_export]
    use super::render::{corner_irradiance, gather, render};
    #[pymodule_export]
    use super::run::start_threads;
    #[pymodule_export]
    use super::scene::Scene;
    #[pymodule_export]
    use super::solve::{ambient, importance, solve, solve_states};
}
