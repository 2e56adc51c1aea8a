//! Long work: off the GIL, on as many threads as asked, interruptible, with progress.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use pyo3::exceptions::{PyMemoryError, PyRuntimeError};
use pyo3::prelude::*;

use super::error::to_python;
use super::reserve;
use crate::error::{Error, Result};
use crate::progress::Progress;

/// How often the waiting thread looks for Ctrl-C and reports progress.
const POLL: Duration = Duration::from_millis(50);

/// Runs `work` on a thread of its own and waits for it, calling `report(done, total)` meanwhile.
///
/// Ctrl-C, or an exception in `report`, is raised at once: the worker is told to stop and left to end by itself, since a
/// factorisation in a library cannot be told anything.
pub(super) fn run<T: Send + 'static>(
    py: Python<'_>,
    threads: Option<usize>,
    report: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Progress) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let progress = Arc::new(Progress::that_watches(&reserve::OUT));
    let (send, mut receive) = channel();
    let shared = Arc::clone(&progress);
    let worker = move || {
        let outcome = catch_unwind(AssertUnwindSafe(|| in_pool(threads, || work(&shared))));
        // The receiver is gone when the caller was interrupted: nobody wants the result then.
        let _ = send.send(outcome);
    };
    std::thread::Builder::new().spawn(worker).map_err(|error| no_threads(1, &error))?;
    loop {
        let received;
        (received, receive) = py.detach(move || (receive.recv_timeout(POLL), receive));
        let tell = |finished: bool| -> PyResult<()> {
            let Some(report) = report else { return Ok(()) };
            let (done, total) = progress.get();
            if finished || total > 0 {
                report.call1((done, total))?;
            }
            Ok(())
        };
        match received {
            Ok(Ok(result)) => {
                let value = result?.map_err(to_python)?;
                tell(true)?;
                return Ok(value);
            }
            Ok(Err(_)) | Err(RecvTimeoutError::Disconnected) => {
                return Err(PyRuntimeError::new_err(
                    "an internal error occurred in the radiosity core; please report it with the input that caused it",
                ));
            }
            Err(RecvTimeoutError::Timeout) => {
                if let Err(error) = py.check_signals().and_then(|()| tell(false)) {
                    progress.stop();
                    return Err(error);
                }
            }
        }
    }
}

/// An exception that a callback has raised on the worker's thread: it waits here until the worker has stopped.
#[derive(Clone, Default)]
pub(super) struct Raised(Arc<Mutex<Option<PyErr>>>);

impl Raised {
    /// Calls back with the GIL; an exception becomes the wish to stop.
    pub(super) fn call(&self, callback: impl FnOnce(Python<'_>) -> PyResult<()>) -> Result<()> {
        Python::attach(callback).map_err(|error| {
            *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
            Error::Interrupted
        })
    }

    /// Whether there is no exception yet; one is the wish to stop.
    pub(super) fn check(&self) -> Result<()> {
        let waits = self.0.lock().unwrap_or_else(PoisonError::into_inner).is_some();
        if waits { Err(Error::Interrupted) } else { Ok(()) }
    }

    /// No more calls: who asks again is told to stop.
    pub(super) fn close(&self) {
        let stopped = || to_python(Error::Interrupted);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(stopped);
    }

    /// What the worker has reached, or what made it stop.
    pub(super) fn or<T>(&self, outcome: PyResult<T>) -> PyResult<T> {
        let raised = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        raised.map_or(outcome, Err)
    }
}

/// The process that the shared pool of threads belongs to: a fork has its memory but not its threads. `None` where the pool
/// could not be started, which rayon tries once only.
static POOL_OWNER: OnceLock<Option<u32>> = OnceLock::new();

/// Runs `work` in a pool of `threads` threads; `None` for the shared pool of all cores.
pub(super) fn in_pool<T: Send>(threads: Option<usize>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    if !reserve::hold() {
        return Err(to_python(Error::OutOfMemory));
    }
    let id = std::process::id();
    let start = || rayon::ThreadPoolBuilder::new().build_global().ok().map(|()| id);
    let threads = match threads {
        None if *POOL_OWNER.get_or_init(start) == Some(id) => return Ok(work()),
        // A pool of its own; 0 means all cores.
        None => 0,
        Some(threads) => threads,
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|e| no_threads(threads, &e))?;
    Ok(pool.install(work))
}

/// Starts the shared pool, and has each of its threads take what the C library sets aside for a thread: what is left then is
/// there for work.
#[pyfunction]
pub(super) fn start_threads(py: Python<'_>) -> PyResult<()> {
    py.detach(|| in_pool(None, || rayon::broadcast(|_| drop(std::hint::black_box(Box::new(0u8))))))?;
    Ok(())
}

/// Threads need memory for their stacks, which is what they lack as a rule.
fn no_threads(threads: usize, error: &dyn std::error::Error) -> PyErr {
    PyMemoryError::new_err(format!("cannot start {threads} threads: {error}"))
}
