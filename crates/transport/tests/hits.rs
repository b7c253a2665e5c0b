//! Rows of counts of hits: the same operator as compressed sparse rows, exact counts, the same bits for any thread
//! count.

use glam::Vec4;
use patchlight_transport::kernel::hits::gather_row_hits;
use patchlight_transport::{Csr, Error, HitCounts, LinearOperator};
use scene::sampling::{hash3, unit};

/// Hits of `rows` rows: some columns take many, ids from `columns` on are the sky's.
fn hits(rows: u32, rays: u32, columns: u32) -> Vec<u32> {
    (0..rows * rays)
        .map(|k| {
            let random = hash3(k, 3, 7);
            match hash3(k, 4, 7) % 4 {
                0 => random % columns,
                1 => random % columns.min(7),
                2 => random % columns.min(40),
                _ => random % (columns + columns / 4 + 1),
            }
        })
        .collect()
}

/// Rows counted one by one.
fn counted(hits: &[u32], columns: usize, scales: &[f32]) -> Csr {
    let rays = hits.len() / scales.len();
    let mut csr = Csr { rows: scales.len(), columns, row_start: vec![0], ..Csr::default() };
    for (row, scale) in hits.chunks(rays).zip(scales) {
        let mut counts = vec![0u32; columns];
        row.iter().filter(|&&j| (j as usize) < columns).for_each(|&j| counts[j as usize] += 1);
        for (j, count) in counts.into_iter().enumerate().filter(|c| c.1 > 0) {
            csr.column_index.push(j as u32);
            csr.values.push(count as f32 * scale);
        }
        csr.row_start.push(csr.values.len() as u32);
    }
    csr
}

fn operator(columns: usize, hits: &[u32], scales: &[f32]) -> HitCounts {
    let mut rows = HitCounts::new(columns).unwrap();
    rows.push(hits, scales).unwrap();
    rows
}

fn exitance(columns: usize) -> Vec<Vec4> {
    let number = |k: usize, c: u32| unit(hash3(k as u32, c, 11));
    (0..columns).map(|k| Vec4::new(number(k, 0), number(k, 1), number(k, 2), number(k, 3))).collect()
}

fn product(operator: &impl LinearOperator, exitance: &[Vec4]) -> Vec<Vec4> {
    let mut out = vec![Vec4::NAN; operator.rows()];
    operator.apply(exitance, &mut out).unwrap();
    out
}

/// Greatest relative difference of the three channels.
fn difference(a: &[Vec4], b: &[Vec4]) -> f32 {
    assert_eq!(a.len(), b.len());
    let one = |(a, b): (&Vec4, &Vec4)| {
        (0..3).map(|c| if a[c] == b[c] { 0.0 } else { (a[c] - b[c]).abs() / b[c].abs() }).fold(0.0, f32::max)
    };
    a.iter().zip(b).map(one).fold(0.0, f32::max)
}

#[test]
fn rows_and_products_are_those_of_sparse_rows() {
    for (rows, rays, columns) in [(1, 1, 1), (5, 3, 2), (37, 100, 65), (150, 512, 1030), (9, 2000, 60_001)] {
        let hits = hits(rows, rays, columns);
        let scales: Vec<f32> = (0..rows).map(|i| (1.0 + unit(hash3(i, 9, 9))) / rays as f32).collect();
        let columns = columns as usize;
        let counts = operator(columns, &hits, &scales);
        let csr = counted(&hits, columns, &scales);
        assert_eq!(counts.to_csr().unwrap(), csr);
        let light = exitance(columns);
        let found = product(&counts, &light);
        let expected = product(&csr, &light);
        // Sums in other orders, of up to 2000 positive terms.
        assert!(difference(&found, &expected) < 4e-6, "{rows} × {columns}: {}", difference(&found, &expected));
        assert!(found.iter().all(|h| h.w == 0.0));
        let words = counts.count_words();
        let body = |i: u32| gather_row_hits(i, 0, counts.row_start(), counts.quads(), &words, counts.scales(), &light);
        assert!(difference(&(0..rows).map(body).collect::<Vec<_>>(), &expected) < 4e-6);
        // One ray that went elsewhere is noticed.
        let mut wrong = hits.clone();
        let at = wrong.iter().position(|&j| (j as usize) < columns).unwrap();
        wrong[at] = columns as u32;
        let wrong = product(&operator(columns, &wrong, &scales), &light);
        assert!(difference(&wrong, &expected) > 4e-6, "{rows} × {columns}");
    }
}

#[test]
fn constant_exitance_gives_the_share_that_is_not_sky() {
    let rows = 40;
    let rays = 512;
    let columns = 300;
    let hits = hits(rows, rays, columns);
    let scales = vec![1.0 / rays as f32; rows as usize];
    let found = product(&operator(columns as usize, &hits, &scales), &vec![Vec4::new(1.0, 2.0, 4.0, 9.0); 300]);
    for (row, h) in hits.chunks(rays as usize).zip(&found) {
        let sky = row.iter().filter(|&&j| j >= columns).count() as f32 / rays as f32;
        assert!(sky > 0.0);
        // Sums of small integers: no rounding at all.
        assert_eq!(*h, Vec4::new(1.0, 2.0, 4.0, 0.0) * (1.0 - sky));
        assert_ne!(h.x, 1.0);
    }
}

#[test]
fn any_count_is_kept() {
    // Every count from 1 to 700 alone, with a near one, and with three others.
    for count in 1..=700u32 {
        for others in [vec![], vec![count - 1], vec![count, count, count], vec![1, count / 2, 2 * count]] {
            let counts: Vec<u32> = std::iter::once(count).chain(others).collect();
            let hits: Vec<u32> =
                counts.iter().zip(0u32..).flat_map(|(&n, j)| std::iter::repeat_n(3 * j + 1, n as usize)).collect();
            let rows = operator(100, &hits, &[0.5]);
            let expected: Vec<(u32, u32)> =
                counts.iter().zip(0u32..).filter(|c| *c.0 > 0).map(|(&n, j)| (3 * j + 1, n)).collect();
            assert_eq!(rows.row(0), expected);
            // One hit more is another row.
            let more = operator(100, &[hits, vec![1]].concat(), &[0.5]);
            assert_ne!(more.row(0), expected);
        }
    }
}

#[test]
fn equal_counts_fill_quads() {
    // 400 columns once each, 80 twice, 6 some more often: little more than 486 / 4 quads.
    let mut row: Vec<u32> = (0..400).collect();
    row.extend((1000..1080).flat_map(|j| [j; 2]));
    row.extend((2000..2006).flat_map(|j| vec![j; j as usize - 1990]));
    let rows = operator(3000, &row, &[1.0]);
    assert!(rows.quads().len() <= 486 / 4 + 5, "{}", rows.quads().len());
    assert_eq!(rows.quads().len(), rows.counts().len());
    assert_eq!(rows.bytes(), (8 * rows.quads().len() + rows.counts().len() + 2 * 4 + 4) as u64);
    // Columns that have no count in common need a quad each.
    let alone: Vec<u32> = (0..5).flat_map(|j| vec![j; 3usize.pow(j)]).collect();
    assert!(operator(3000, &alone, &[1.0]).quads().len() >= 5);
}

#[test]
fn blocks_and_threads_change_no_byte() {
    let rows = 333;
    let rays = 128;
    let columns = 500;
    let hits = hits(rows, rays, columns);
    let scales: Vec<f32> = (0..rows).map(|i| unit(hash3(i, 2, 2))).collect();
    let light = exitance(columns as usize);
    let whole = operator(columns as usize, &hits, &scales);
    let on = |threads: usize, block: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut rows = HitCounts::new(columns as usize).unwrap();
            for (hits, scales) in hits.chunks(block * rays as usize).zip(scales.chunks(block)) {
                rows.push(hits, scales).unwrap();
            }
            let found = product(&rows, &light);
            (rows, found)
        })
    };
    let one = on(1, 333);
    let two = on(2, 50);
    let three = on(3, 1);
    assert!(one == two && two == three && one.0 == whole);
    assert_ne!(product(&whole, &exitance(columns as usize).into_iter().rev().collect::<Vec<_>>()), one.1);
}

#[test]
fn rows_without_hits_are_dark() {
    let rows = operator(3, &[3, 4, u32::MAX, 1, 1, 1], &[1.0, 0.25]);
    assert_eq!(rows.row(0), []);
    assert_eq!(rows.row(2), []);
    assert_eq!(product(&rows, &[Vec4::ONE; 3]), [Vec4::ZERO, Vec4::new(0.75, 0.75, 0.75, 0.0)]);
    let mut none = HitCounts::new(0).unwrap();
    none.push(&[], &[1.0, 1.0]).unwrap();
    none.push(&[], &[]).unwrap();
    assert_eq!(product(&none, &[]), [Vec4::ZERO; 2]);
}

#[test]
fn wrong_shapes_are_refused() {
    assert!(HitCounts::new(65_536).is_ok());
    assert_eq!(HitCounts::new(65_537), Err(Error::TooMany { name: "columns", found: 65_537, limit: 65_536 }));
    let mut rows = HitCounts::new(4).unwrap();
    assert!(matches!(rows.push(&[1, 2, 3], &[1.0, 1.0]), Err(Error::Length { name: "hits", found: 3, .. })));
    assert!(matches!(rows.push(&[1, 2, 3], &[]), Err(Error::Length { name: "hits", .. })));
    assert!(matches!(rows.push(&[1, 2], &[1.0, f32::NAN]), Err(Error::Value { name: "scales", index: 1, .. })));
    assert_eq!(rows, HitCounts::new(4).unwrap());
    rows.push(&[65_535, 3], &[1.0, 2.0]).unwrap();
    let mut out = [Vec4::ZERO; 2];
    rows.apply(&[Vec4::ONE; 4], &mut out).unwrap();
    assert_eq!(out[1].x, 2.0);
    assert!(matches!(rows.apply(&[Vec4::ONE; 3], &mut out), Err(Error::Length { name: "exitance", .. })));
    assert!(matches!(rows.apply(&[Vec4::ONE; 5], &mut out), Err(Error::Length { name: "exitance", .. })));
    assert!(matches!(rows.apply(&[Vec4::ONE; 4], &mut out[1..]), Err(Error::Length { name: "irradiance", .. })));
}
