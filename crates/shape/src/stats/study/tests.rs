use super::*;

fn column(name: &str, cells: &str) -> Term {
    Term::Column(name.to_owned(), Column::of(cells.split(' ')))
}

fn interaction(first: (&str, &str), second: (&str, &str)) -> Term {
    Term::Interaction([first, second].map(|(name, cells)| (name.to_owned(), Column::of(cells.split(' ')))))
}

const GROUP: &str = "b a a b b a";

#[test]
fn effects_and_covariates_become_columns() {
    let group = column("group", GROUP);
    let covariates = [column("age", "1 2 3 4 5 9"), column("site", "x y z x z y")];
    let found = question(&group, &[], &covariates).unwrap();
    assert_eq!(found.design.names(), ["a", "b", "age", "site y", "site z"]);
    assert_eq!(found.contrast.weights, ndarray::array![[1.0, -1.0, 0.0, 0.0, 0.0]]);
    assert_eq!((found.meaning.as_str(), found.levels[1].1), ("a - b", 3));
    assert_eq!(found.design.matrix().column(2).sum(), 0.0);
    let order = ["b".to_owned(), "a".to_owned()];
    assert_eq!(question(&group, &order, &[]).unwrap().meaning, "b - a");
    let found = question(&group, &[&order[..], &["b".to_owned()]].concat(), &[]).unwrap_err();
    assert_eq!(found.to_string(), "levels: expected each level of \"group\" once, found the duplicate level \"b\"");
    let slope = question(&covariates[0], &[], &[group]).unwrap();
    assert_eq!(slope.design.names(), ["mean", "age", "group b"]);
    assert_eq!(slope.contrast.weights, ndarray::array![[0.0, 1.0, 0.0]]);
    let three = question(&covariates[1], &[], &[]).unwrap();
    assert_eq!(three.contrast.weights, ndarray::array![[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]]);
}

#[test]
fn levels_that_differ_only_in_case_are_doubted() {
    let found = question(&column("group", "A a B b A a"), &[], &[]).unwrap();
    let texts: Vec<String> = found.warnings.iter().map(ToString::to_string).collect();
    assert_eq!((found.levels.len(), texts.len()), (4, 2));
    assert!(texts[0].starts_with("group: the levels \"A\" and \"a\" differ only in case"), "{texts:?}");
    let spaced = Column::Levels(["x", "x ", "y", "x", "y", "y"].map(str::to_owned).to_vec());
    let site = Term::Column("site".to_owned(), spaced);
    let expected = TestWarning::SimilarLevels { column: "site".to_owned(), levels: ["x".to_owned(), "x ".to_owned()] };
    assert_eq!(mean_question(6, &[site]).unwrap().warnings, [expected]);
    assert!(question(&column("group", GROUP), &[], &[column("age", "1 2 3 4 5 9")]).unwrap().warnings.is_empty());
}

#[test]
fn interactions_compare_slopes_and_differences() {
    let slopes = question(&interaction(("group", GROUP), ("age", "1 2 3 4 5 9")), &[], &[]).unwrap();
    assert_eq!(slopes.design.names(), ["a", "b", "a:age", "b:age"]);
    assert_eq!(slopes.contrast.weights, ndarray::array![[0.0, 0.0, 1.0, -1.0]]);
    assert_eq!(slopes.meaning, "slope of age in a minus slope of age in b");
    let (site, sex) = (("site", "x x x x y y y y"), ("sex", "f f m m f f m m"));
    let cells =
        question(&interaction(site, sex), &["y".to_owned(), "x".to_owned()], &[column("site", site.1)]).unwrap();
    assert_eq!(cells.design.names(), ["y:f", "y:m", "x:f", "x:m"]);
    assert_eq!(cells.contrast.weights, ndarray::array![[1.0, -1.0, -1.0, 1.0]]);
    assert_eq!(cells.meaning, "(y - x at f) - (y - x at m)");
    assert_eq!(cells.levels[3], ("x:m".to_owned(), 2));
    let numbers = question(&interaction(("age", "1 2 3 4 6 5"), ("size", "3 1 4 1 5 9")), &[], &[]).unwrap();
    assert_eq!(numbers.design.names(), ["mean", "age", "size", "age:size"]);
    let missing = interaction(("site", "x x x y y"), ("sex", "f m f f f"));
    let found = question(&missing, &[], &[]).unwrap_err();
    assert!(matches!(&found, ShapeError::EmptyCell { levels, .. } if *levels == ["y", "m"]), "{found}");
    let found = question(&interaction(("group", "a a a b b"), ("age", "1 2 3 7 7")), &[], &[]).unwrap_err();
    assert!(matches!(&found, ShapeError::Constant { column, .. } if column == "age in b"), "{found}");
    let order = ["1".to_owned(), "2".to_owned()];
    let found = question(&interaction(("group", "1 1 1 2 2"), ("age", "1 2 3 7 7")), &order, &[]).unwrap_err();
    assert!(matches!(found, ShapeError::Setting { name: "the order of levels", .. }), "{found}");
}

#[test]
fn covariates_may_interact_and_bring_their_columns() {
    let group = column("group", "a a a a b b b b");
    let covariates = [interaction(("group", "a a a a b b b b"), ("age", "1 2 3 4 9 6 7 8"))];
    let found = question(&group, &[], &covariates).unwrap();
    assert_eq!(found.design.names(), ["a", "b", "age", "group b:age"]);
    let turned = interaction(("age", "1 2 3 4 9 6 7 8"), ("group", "a a a a b b b b"));
    assert_eq!(question(&turned, &[], &covariates).unwrap().design.names(), ["a", "b", "a:age", "b:age"]);
    let twice = [covariates[0].clone(), turned];
    assert_eq!(question(&group, &[], &twice).unwrap().design.names().len(), 4);
    let mean = mean_question(8, &covariates).unwrap();
    assert_eq!(mean.design.names(), ["mean", "group b", "age", "group b:age"]);
    let listed = [covariates[0].clone(), column("age", "1 2 3 4 9 6 7 8")];
    assert_eq!(question(&group, &[], &listed).unwrap().design.names().len(), 4);
}

/// If the subjects are a covariate, they contain the effect of the group. The interaction is the same as in a design
/// that has only the subjects' levels and the interaction's own columns.
#[test]
fn main_effects_that_subjects_contain_are_left_out() {
    let (group, age) = ("a a a a b b b b", "1 2 2 4 9 6 7 8");
    let subject = column("subject", "s1 s1 s2 s2 s3 s3 s4 s4");
    let estimate = |asked: &Question, values: &Array2<f64>| {
        let (basis, u) = contrast_in_basis(&asked.design, &asked.contrast);
        product(u.t(), product(basis.t(), values.view()).view())[[0, 0]]
    };
    let of_subject = [5.0, -2.0, 11.0, 3.0];
    let ages = [1.0, 2.0, 2.0, 4.0, 9.0, 6.0, 7.0, 8.0];
    let slopes = question(&interaction(("group", group), ("age", age)), &[], std::slice::from_ref(&subject)).unwrap();
    assert_eq!(slopes.design.names()[..3], ["mean", "a:age", "b:age"]);
    assert_eq!(slopes.contained(), [["group", "subject"].map(str::to_owned)]);
    let slope = |i: usize| if i < 4 { 0.5 } else { -0.25 };
    let values = Array2::from_shape_fn((8, 1), |(i, _)| of_subject[i / 2] + slope(i) * ages[i]);
    assert!((estimate(&slopes, &values) - 0.75).abs() < 1e-12);
    // Each subject has two rows, for the visits x and y or for the visits y and x.
    let visit = "x y y x x y y x";
    let is_x = |i: usize| visit.as_bytes()[2 * i] == b'x';
    let change = |i: usize| if is_x(i) { 3.0 * slope(i) } else { 0.0 };
    let values = Array2::from_shape_fn((8, 1), |(i, _)| of_subject[i / 2] + change(i));
    for (first, second, own) in [
        (("group", group), ("visit", visit), ["mean", "a:y", "b:y"]),
        (("visit", visit), ("group", group), ["mean", "y:a", "y:b"]),
    ] {
        let cells = question(&interaction(first, second), &[], std::slice::from_ref(&subject)).unwrap();
        assert_eq!(cells.design.names()[..3], own);
        assert!((estimate(&cells, &values) - 2.25).abs() < 1e-12, "{}", cells.meaning);
    }
    let numbers =
        question(&interaction(("dose", "1 1 2 2 4 4 9 9"), ("age", age)), &[], std::slice::from_ref(&subject));
    assert_eq!(numbers.unwrap().design.names()[..3], ["mean", "age", "dose:age"]);
    // If the interaction is a covariate, the design doesn't include the effect of the group either.
    let covariates = [subject.clone(), interaction(("group", group), ("age", age))];
    let found = question(&column("age", age), &[], &covariates).unwrap();
    assert_eq!(found.design.names().len(), 6);
    assert_eq!(found.contained(), [["group", "subject"].map(str::to_owned)]);
    // In group b, the age doesn't vary within subjects, so this group has no slope.
    let constant = interaction(("group", group), ("age", "1 2 2 4 9 9 7 7"));
    assert!(matches!(question(&constant, &[], &[subject]), Err(ShapeError::Rank { .. })));
}

#[test]
fn numbers_far_from_all_others_are_doubted() {
    let age = column("age", "31 42 55 61 -999 33 40 52 66 71");
    let expected = TestWarning::FarValue { column: "age".to_owned(), row: 5, value: -999.0, median: 52.0 };
    let found = question(&column("group", "a a a a a b b b b b"), &[], std::slice::from_ref(&age)).unwrap();
    assert_eq!(found.warnings, std::slice::from_ref(&expected));
    assert_eq!(question(&age, &[], &[]).unwrap().warnings, [expected]);
    // The largest numbers of skewed data are far from the other numbers, but don't look like codes.
    for (volumes, warnings) in [
        ("1 2 3 4 5 9 17 33 65 129", 0),
        ("1 2 3 4 5 9 17 33 65 1290.5", 0),
        ("1 2 3 4 5 9 17 33 65 999.9", 1),
        ("1 2 3 4 5 9 17 33 65 1e30", 1),
        ("4001 4002 4003 4004 4005 4009 4017 4033 4065 -1", 1),
    ] {
        assert_eq!(question(&column("volume", volumes), &[], &[]).unwrap().warnings.len(), warnings, "{volumes}");
    }
    assert_eq!(Column::of(["\u{2212}1", "2"]), Column::Numbers(vec![-1.0, 2.0]));
}

#[test]
fn contrasts_replace_the_default_one() {
    let group = column("group", "a a a b b b c c c");
    let ask = |rows: &[&str]| question(&group, &[], &[]).unwrap().with_contrast(rows);
    let one = ask(&["c - 0.5 a - 0.5 b"]).unwrap();
    assert_eq!(one.contrast.weights, ndarray::array![[-0.5, -0.5, 1.0]]);
    assert_eq!(one.meaning, "c - 0.5 a - 0.5 b");
    let two = ask(&["a - b", "a - c"]).unwrap();
    assert!(!one.is_of_means() && ask(&["a - b", "c"]).unwrap().is_of_means());
    assert_eq!((two.contrast.weights.nrows(), two.meaning.as_str()), (2, "any of a - b; a - c"));
}

#[test]
fn columns_that_say_nothing_are_refused() {
    assert!(matches!(question(&column("group", "a a a"), &[], &[]), Err(ShapeError::Levels { .. })));
    let order = ["a".to_owned(), "c".to_owned()];
    let group = column("group", "a b a");
    assert!(matches!(question(&group, &order, &[]), Err(ShapeError::Levels { .. })));
    let short = [column("age", "1 2")];
    assert!(matches!(question(&group, &[], &short), Err(ShapeError::Subjects { .. })));
    let constant = column("age", "7 7 7 7");
    let found = question(&constant, &[], &[]).unwrap_err();
    assert!(matches!(&found, ShapeError::Constant { column, value: 7.0 } if column == "age"), "{found}");
    let pairs = column("group", "a b a b");
    let found = question(&pairs, &[], &[constant]).unwrap_err();
    assert!(matches!(found, ShapeError::Constant { .. }), "{found}");
    assert!(matches!(question(&pairs, &[], &[column("sex", "m f m f")]), Err(ShapeError::Rank { .. })));
}

/// The mean of a group is the value of its regression line at the average age of all subjects. This holds whether the
/// interaction of group and age is the effect or a covariate.
#[test]
fn means_of_levels_are_those_of_average_subjects() {
    let (ages, groups) = ([1.0, 2.0, 3.0, 5.0, 8.0, 9.0, 9.5, 12.0], "a a a a b b b b");
    let line = |i: usize| if i < 4 { 2.0 + 0.5 * ages[i] } else { 7.0 - 0.25 * ages[i] };
    let values = Array2::from_shape_fn((8, 1), |(i, _)| line(i));
    let mean = ages.iter().sum::<f64>() / 8.0;
    let age = Term::Column("age".to_owned(), Column::Numbers(ages.to_vec()));
    let both = match (column("group", groups), age.clone()) {
        (Term::Column(a, x), Term::Column(b, z)) => Term::Interaction([(a, x), (b, z)]),
        _ => unreachable!("columns"),
    };
    let tested = [question(&both, &[], &[]), question(&column("group", groups), &[], std::slice::from_ref(&both))];
    for asked in tested {
        let asked = asked.unwrap().with_contrast(&["a"]).unwrap();
        let (basis, u) = contrast_in_basis(&asked.design, &asked.contrast);
        let estimate = product(u.t(), product(basis.t(), values.view()).view())[[0, 0]];
        assert!((estimate - (2.0 + 0.5 * mean)).abs() < 1e-12, "{estimate}");
    }
}
