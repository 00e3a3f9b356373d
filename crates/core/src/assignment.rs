//! Minimum-cost assignment: rows to columns, each at most once, a row may stay alone.
//!
//! Shortest augmenting paths with potentials (Jonker & Volgenant 1987; Kuhn 1955), O(rows² · columns). Costs below zero
//! are gains: a row is assigned only where that lowers the total. Ties go to the smaller column, so the answer does not
//! depend on anything but the costs.

/// Pairs (row, column) with the least total cost. `cost(row, column)` is `None` where the pair is impossible; staying
/// alone costs nothing.
pub fn assign(rows: usize, columns: usize, cost: impl Fn(usize, usize) -> Option<f64>) -> Vec<Option<usize>> {
    if rows == 0 || columns == 0 {
        return vec![None; rows];
    }
    // Every row gets a private column of cost 0, so that a full assignment always exists.
    let width = columns + rows;
    let mut matrix = vec![f64::INFINITY; rows * width];
    for row in 0..rows {
        for column in 0..columns {
            if let Some(c) = cost(row, column).filter(|c| *c < 0.0) {
                matrix[row * width + column] = c;
            }
        }
        matrix[row * width + columns + row] = 0.0;
    }
    let owner = augment(&matrix, rows, width);
    let mut found = vec![None; rows];
    for (column, row) in owner.iter().take(columns).enumerate() {
        if let Some(row) = row {
            found[*row] = Some(column);
        }
    }
    found
}

/// The row that owns each column in the full assignment of least cost.
fn augment(matrix: &[f64], rows: usize, width: usize) -> Vec<Option<usize>> {
    let mut row_potential = vec![0.0; rows];
    let mut column_potential = vec![0.0; width];
    let mut owner: Vec<Option<usize>> = vec![None; width];
    let mut distance = vec![0.0; width];
    let mut before: Vec<Option<usize>> = vec![None; width];
    let mut done = vec![false; width];
    for start in 0..rows {
        distance.fill(f64::INFINITY);
        before.fill(None);
        done.fill(false);
        let (mut row, mut reached, mut at) = (start, 0.0, None);
        let end = loop {
            let mut nearest: Option<usize> = None;
            for column in 0..width {
                if done[column] {
                    continue;
                }
                let reduced = matrix[row * width + column] - row_potential[row] - column_potential[column] + reached;
                if reduced < distance[column] {
                    distance[column] = reduced;
                    before[column] = at;
                }
                if nearest.is_none_or(|n| distance[column] < distance[n]) {
                    nearest = Some(column);
                }
            }
            let column = nearest.expect("every row has a private column");
            done[column] = true;
            reached = distance[column];
            at = Some(column);
            match owner[column] {
                Some(next) => row = next,
                None => break column,
            }
        };
        row_potential[start] += reached;
        for column in 0..width {
            if done[column] && column != end {
                let change = reached - distance[column];
                column_potential[column] -= change;
                if let Some(row) = owner[column] {
                    row_potential[row] += change;
                }
            }
        }
        let mut column = end;
        while let Some(previous) = before[column] {
            owner[column] = owner[previous];
            column = previous;
        }
        owner[column] = Some(start);
    }
    owner
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn best_by_trying(costs: &[Vec<Option<f64>>], row: usize, used: &mut Vec<bool>) -> f64 {
        if row == costs.len() {
            return 0.0;
        }
        let mut best = best_by_trying(costs, row + 1, used);
        for (column, cost) in costs[row].iter().enumerate() {
            if let (Some(c), false) = (cost, used[column]) {
                used[column] = true;
                best = best.min(c + best_by_trying(costs, row + 1, used));
                used[column] = false;
            }
        }
        best
    }

    proptest! {
        #[test]
        fn the_total_is_the_least_of_all_assignments(
            costs in (1usize..6, 1usize..6).prop_flat_map(|(r, c)| {
                prop::collection::vec(prop::collection::vec(prop::option::weighted(0.7, -5.0..3.0f64), c), r)
            })
        ) {
            let columns = costs[0].len();
            let found = assign(costs.len(), columns, |r, c| costs[r][c]);
            let mut used = vec![false; columns];
            let mut total = 0.0;
            for (row, column) in found.iter().enumerate() {
                if let Some(c) = column {
                    prop_assert!(!used[*c]);
                    used[*c] = true;
                    total += costs[row][*c].unwrap();
                }
            }
            let best = best_by_trying(&costs, 0, &mut vec![false; columns]);
            prop_assert!((total - best).abs() < 1e-9, "{total} against {best}");
        }
    }

    #[test]
    fn nothing_to_assign_is_no_error() {
        assert_eq!(assign(0, 3, |_, _| Some(-1.0)), Vec::<Option<usize>>::new());
        assert_eq!(assign(2, 0, |_, _| Some(-1.0)), vec![None, None]);
        assert_eq!(assign(1, 1, |_, _| Some(1.0)), vec![None]);
    }
}
