//! A symmetric matrix G with an empty diagonal, stored once: the entries G_ij with j < i, row by row.
//!
//! Whole, row i holds its i entries one after the other, from place i (i - 1) / 2 on: 8 bytes a pair. Where few patches see each
//! other, only what is not 0 is kept, with its column; and, so that column j is found without a search, the places of its
//! entries: 20 bytes an entry and 16 a row. Values lie in a vector beside the pattern, so that vectors of the same pattern (weights,
//! changes) share it.

use std::ops::Range;
use std::sync::Arc;

use crate::error::{Error, Result};
use crate::memory::{filled, room};

/// Which pairs i > j have an entry, and where its value is; a copy of it is the same memory.
#[derive(Debug, Clone)]
pub struct Pattern {
    n: usize,
    entries: Option<Arc<Entries>>,
}

/// The entries that are kept, where not all of them are.
#[derive(Debug, Clone)]
struct Entries {
    /// Row i has the places start[i] .. start[i + 1].
    start: Vec<usize>,
    /// The column of every place, ascending in a row.
    column: Vec<u32>,
    /// Column j has the entries down[j] .. down[j + 1] of the next two.
    down: Vec<usize>,
    row: Vec<u32>,
    place: Vec<u32>,
}

/// First entry of row i where all are kept.
#[inline]
fn row_start(i: usize) -> usize {
    i * i.saturating_sub(1) / 2
}

impl Pattern {
    /// Of every pair of `n` patches.
    pub fn whole(n: usize) -> Pattern {
        Pattern { n, entries: None }
    }

    /// Of some pairs of `n` patches: row i has those with the columns `column[start[i] .. start[i + 1]]`.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the starts are not those of n rows of the columns, or the columns of a row do not ascend below its
    /// number; [`Error::OutOfMemory`].
    pub fn from_entries(n: usize, start: Vec<usize>, column: Vec<u32>) -> Result<Pattern> {
        let is_sound = start.len() == n + 1
            && start.first() == Some(&0)
            && start.windows(2).all(|w| w[0] <= w[1])
            && start.last() == Some(&column.len())
            && u32::try_from(column.len()).is_ok();
        if !is_sound {
            let (starts, count) = (start.len(), column.len());
            return Err(Error::Invalid(format!(
                "the {starts} starts of {n} rows do not ascend from 0 to {count} columns"
            )));
        }
        for i in 0..n {
            let row = &column[start[i]..start[i + 1]];
            if !(row.windows(2).all(|w| w[0] < w[1]) && row.last().is_none_or(|&j| (j as usize) < i)) {
                return Err(Error::Invalid(format!("row {i}: its columns do not ascend below {i}")));
            }
        }
        let mut down = filled(n + 1, 0)?;
        column.iter().for_each(|&j| down[j as usize + 1] += 1);
        for j in 0..n {
            down[j + 1] += down[j];
        }
        let mut next = down.clone();
        let (mut row, mut place) = (filled(column.len(), 0u32)?, filled(column.len(), 0u32)?);
        for i in 0..n {
            for k in start[i]..start[i + 1] {
                let to = &mut next[column[k] as usize];
                (row[*to], place[*to]) = (i as u32, k as u32);
                *to += 1;
            }
        }
        Ok(Pattern { n, entries: Some(Arc::new(Entries { start, column, down, row, place })) })
    }

    /// Where the rows start among the columns, and the columns; `None` where every pair has an entry.
    pub fn entries(&self) -> Option<(&[usize], &[u32])> {
        self.entries.as_ref().map(|entries| (entries.start.as_slice(), entries.column.as_slice()))
    }

    /// Number of patches.
    pub(super) fn patches(&self) -> usize {
        self.n
    }

    /// Number of entries.
    pub(super) fn len(&self) -> usize {
        self.entries.as_ref().map_or(row_start(self.n), |entries| entries.column.len())
    }

    /// The places of row i.
    pub(super) fn places(&self, i: usize) -> Range<usize> {
        match self.entries.as_deref() {
            None => row_start(i)..row_start(i + 1),
            Some(entries) => entries.start[i]..entries.start[i + 1],
        }
    }

    /// The place of a pair i > j that is kept.
    pub(super) fn place(&self, i: usize, j: usize) -> Option<usize> {
        let places = self.places(i);
        match self.entries.as_deref() {
            None => Some(places.start + j),
            Some(Entries { column, .. }) => {
                let found = column[places.clone()].binary_search(&(j as u32));
                found.ok().map(|k| places.start + k)
            }
        }
    }

    /// Calls `visit(j, place)` for the entries of row i, j < i, in the order of j.
    #[inline]
    pub(super) fn lower(&self, i: usize, mut visit: impl FnMut(usize, usize)) {
        let places = self.places(i);
        match self.entries.as_deref() {
            None => places.enumerate().for_each(|(j, place)| visit(j, place)),
            Some(Entries { column, .. }) => {
                places.clone().zip(&column[places]).for_each(|(place, &j)| visit(j as usize, place));
            }
        }
    }

    /// The same for some of the columns below i.
    #[inline]
    pub(super) fn within(&self, i: usize, columns: Range<usize>, mut visit: impl FnMut(usize, usize)) {
        let first = self.places(i).start;
        match self.entries.as_deref() {
            None => columns.for_each(|j| visit(j, first + j)),
            Some(Entries { column, .. }) => {
                let row = &column[self.places(i)];
                let [from, to] = [columns.start, columns.end].map(|end| row.partition_point(|&j| (j as usize) < end));
                (from..to).for_each(|k| visit(row[k] as usize, first + k));
            }
        }
    }

    /// Calls `visit(j, place)` for the entries of column i, j > i, in the order of j.
    #[inline]
    fn upper(&self, i: usize, mut visit: impl FnMut(usize, usize)) {
        match self.entries.as_deref() {
            None => (i + 1..self.n).for_each(|j| visit(j, row_start(j) + i)),
            Some(Entries { down, row, place, .. }) => {
                let range = down[i]..down[i + 1];
                row[range.clone()].iter().zip(&place[range]).for_each(|(&j, &k)| visit(j as usize, k as usize));
            }
        }
    }

    /// Calls `visit(j, place)` for all that i exchanges with, in the order of j.
    #[inline]
    pub(super) fn partners(&self, i: usize, mut visit: impl FnMut(usize, usize)) {
        self.lower(i, &mut visit);
        self.upper(i, visit);
    }

    /// Bytes held.
    pub(super) fn nbytes(&self) -> usize {
        self.entries.as_deref().map_or(0, |Entries { start, column, down, row, place }| {
            size_of_val(start.as_slice())
                + size_of_val(down.as_slice())
                + [column, row, place].iter().map(|part| size_of_val(part.as_slice())).sum::<usize>()
        })
    }
}

/// One row as it was found: all of it, or the columns that are not 0 and their values.
pub(super) struct Row {
    column: Vec<u32>,
    value: Vec<f64>,
}

impl Row {
    /// Row i, whichever way is shorter.
    pub(super) fn new(i: usize, column: Vec<u32>, value: Vec<f64>) -> Row {
        if 12 * column.len() <= 8 * i {
            return Row { column, value };
        }
        let mut all = vec![0.0; i];
        column.iter().zip(value).for_each(|(&j, g)| all[j as usize] = g);
        Row { column: Vec::new(), value: all }
    }
}

/// A triangle in the making: rows are added from the first to the last.
#[derive(Default)]
pub(super) struct Builder {
    /// Where each row ends, in the columns and in the values.
    ends: Vec<[usize; 2]>,
    column: Vec<u32>,
    value: Vec<f64>,
    entries: usize,
}

impl Builder {
    /// Adds the next row.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`].
    pub(super) fn add(&mut self, row: Row) -> Result<()> {
        let Row { column, value } = row;
        self.entries += value.iter().filter(|g| **g != 0.0).count();
        grow(&mut self.column, column.len())?;
        grow(&mut self.value, value.len())?;
        grow(&mut self.ends, 1)?;
        self.column.extend(column);
        self.value.extend(value);
        self.ends.push([self.column.len(), self.value.len()]);
        Ok(())
    }

    /// Bytes that the triangle of the rows so far takes in the end.
    pub(super) fn nbytes(&self) -> u64 {
        let n = self.ends.len();
        if self.keeps_all() { 8 * row_start(n) as u64 } else { Builder::bytes_of_entries(n, self.entries) }
    }

    fn bytes_of_entries(n: usize, entries: usize) -> u64 {
        20 * entries as u64 + 16 * (n as u64 + 1)
    }

    /// Whether all entries are kept: leaving out has to save a quarter, for it makes products slower.
    fn keeps_all(&self) -> bool {
        let n = self.ends.len();
        let many = self.entries > u32::MAX as usize;
        many || 4 * Builder::bytes_of_entries(n, self.entries) > 3 * 8 * row_start(n) as u64
    }

    /// The triangle of all rows, with its values.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`].
    pub(super) fn finish(self) -> Result<(Pattern, Vec<f64>)> {
        if self.keeps_all() { self.with_all() } else { self.with_entries() }
    }

    /// The columns, values and number of a row that has been added.
    fn row(&self, i: usize) -> [Range<usize>; 2] {
        let first = if i == 0 { [0; 2] } else { self.ends[i - 1] };
        [first[0]..self.ends[i][0], first[1]..self.ends[i][1]]
    }

    /// Every row made whole, in place: from the last to the first nothing is overwritten that is still needed.
    fn with_all(mut self) -> Result<(Pattern, Vec<f64>)> {
        let n = self.ends.len();
        let missing = row_start(n) - self.value.len();
        self.value.try_reserve_exact(missing).map_err(|_| Error::OutOfMemory)?;
        self.value.resize(row_start(n), 0.0);
        for i in (0..n).rev() {
            let [columns, values] = self.row(i);
            let (from, to) = (values.start, row_start(i));
            if values.len() == i {
                self.value.copy_within(values, to);
                continue;
            }
            // The last column first: it lies no further left in the whole row.
            let (mut next, mut k) = (i, values.len());
            while k > 0 {
                k -= 1;
                let j = self.column[columns.start + k] as usize;
                let g = self.value[from + k];
                self.value[to + j + 1..to + next].fill(0.0);
                self.value[to + j] = g;
                next = j;
            }
            self.value[to..to + next].fill(0.0);
        }
        Ok((Pattern::whole(n), self.value))
    }

    /// Only what is not 0, in place, and the columns.
    fn with_entries(mut self) -> Result<(Pattern, Vec<f64>)> {
        let n = self.ends.len();
        let mut start = room(n + 1)?;
        start.push(0);
        let mut column = room(self.entries)?;
        for i in 0..n {
            let [columns, values] = self.row(i);
            for k in 0..values.len() {
                let g = self.value[values.start + k];
                if g != 0.0 {
                    self.value[column.len()] = g;
                    column.push(if columns.is_empty() { k as u32 } else { self.column[columns.start + k] });
                }
            }
            start.push(column.len());
        }
        let mut value = self.value;
        value.truncate(column.len());
        value.shrink_to_fit();
        Ok((Pattern::from_entries(n, start, column)?, value))
    }
}

/// Room for some more.
fn grow<T>(values: &mut Vec<T>, more: usize) -> Result<()> {
    values.try_reserve(more).map_err(|_| Error::OutOfMemory)
}
