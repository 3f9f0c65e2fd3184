//! Model of the steps of `store-format.md`, "Writing", for one file: two builders, a `gc` that never ends, a reader,
//! and a kill or a power cut at any moment.
//!
//! A power cut does more harm than a journalling file system allows: each name that wasn't synced to disk may be lost
//! or not, independently of the others, and so may the contents of each file.

use stateright::{Model, Property};

/// States of a file's contents: a part, then all of it.
const PART: u8 = 1;
const WHOLE: u8 = 2;
/// Maximum number of files that are created; a process that needs another file stops.
const MOST_FILES: usize = 4;
const BUILDERS: usize = 2;
/// Number of the process that removes leftovers; builders have the numbers below.
const GC: usize = BUILDERS;

/// Behaviour of `flock`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Locks {
    /// `flock` gives an exclusive lock.
    Honest,
    /// `flock` fails.
    None,
    /// `flock` reports success but excludes no other process.
    Lying,
}

/// A change of the protocol that violates a property.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Broken {
    /// The file gets its final name before its footer is written.
    NamedBeforeItIsWhole,
    /// The file gets its final name before its contents are synced to disk.
    NamedBeforeItIsOnDisk,
    /// The folder isn't synced to disk.
    FolderNotSynced,
    /// An existing file with the final name is replaced.
    Replaces,
    /// A builder doesn't lock its temporary file.
    FileNotLocked,
    /// A builder doesn't check whether its file lost its name before the file was locked.
    NameNotChecked,
    /// Leftovers are removed without being locked first.
    RemovesWithoutLock,
}

impl Broken {
    pub(crate) const ALL: [Self; 7] = [
        Self::NamedBeforeItIsWhole,
        Self::NamedBeforeItIsOnDisk,
        Self::FolderNotSynced,
        Self::Replaces,
        Self::FileNotLocked,
        Self::NameNotChecked,
        Self::RemovesWithoutLock,
    ];
}

/// The variant of the protocol that is checked.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Protocol {
    pub(crate) locks: Locks,
    /// Whether the folder has a `.lock` that can be opened.
    pub(crate) folder_lock: bool,
    /// Whether `link` and `unlink` are used instead of `renameat2`.
    pub(crate) links: bool,
    pub(crate) broken: Option<Broken>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct File {
    /// Contents that readers see, and contents that are on disk.
    written: u8,
    on_disk: u8,
    lock: Option<usize>,
    /// Whether the temporary name exists, and whether it is on disk.
    named: bool,
    named_on_disk: bool,
}

/// Step of a process. Each number is the index of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Step {
    Begin,
    WaitForFolder,
    LookAgain,
    Clear,
    Opened(usize),
    Holding(usize),
    Create,
    Created(usize),
    Write(usize),
    Finish(usize),
    Sync(usize),
    Name(usize),
    Linked(usize),
    SyncFolder,
    Done,
    Failed,
    Dead,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct State {
    files: Vec<File>,
    /// Index of the file with the final name: in the folder, and on disk.
    published: Option<usize>,
    published_on_disk: Option<usize>,
    folder_lock: Option<usize>,
    steps: [Step; BUILDERS + 1],
    reader: Option<usize>,
    /// Whether a builder has reported success.
    promised: bool,
    killed: bool,
    power_cut: bool,
    removed_a_leftover: bool,
    lost_a_race: bool,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    Step(usize),
    Open(usize, usize),
    StopClearing(usize),
    Read,
    Kill(usize),
    /// A power cut. The bits state what survives: the final name, and the name and the contents of each file.
    PowerCut(u32),
}

impl State {
    /// Releases the locks of a process.
    fn let_go(&mut self, process: usize) {
        self.folder_lock = self.folder_lock.filter(|&holder| holder != process);
        for file in &mut self.files {
            file.lock = file.lock.filter(|&holder| holder != process);
        }
    }

    fn end(&mut self, process: usize, step: Step) {
        self.let_go(process);
        self.steps[process] = step;
    }
}

impl Protocol {
    fn is(&self, broken: Broken) -> bool {
        self.broken == Some(broken)
    }

    fn has_folder_lock(&self) -> bool {
        self.folder_lock && self.locks == Locks::Honest
    }

    /// Tries to lock a file; returns `None` if the system has no locks.
    fn try_lock(&self, state: &mut State, file: usize, process: usize) -> Option<bool> {
        match self.locks {
            Locks::None => None,
            Locks::Lying => Some(true),
            Locks::Honest => {
                let free = state.files[file].lock.is_none();
                if free {
                    state.files[file].lock = Some(process);
                }
                Some(free)
            }
        }
    }

    fn step(&self, state: &mut State, process: usize) {
        let next = match state.steps[process] {
            Step::Begin => {
                if state.published.is_some() {
                    Step::Done
                } else {
                    Step::WaitForFolder
                }
            }
            Step::WaitForFolder => {
                if self.has_folder_lock() {
                    state.folder_lock = Some(process);
                }
                Step::LookAgain
            }
            Step::LookAgain => {
                if state.published.is_some() {
                    Step::Done
                } else {
                    Step::Clear
                }
            }
            Step::Opened(file) if self.is(Broken::RemovesWithoutLock) => Step::Holding(file),
            Step::Opened(file) => match self.try_lock(state, file, process) {
                Some(true) => Step::Holding(file),
                // The file is in use or, without locks, too young to be a leftover.
                _ => Step::Clear,
            },
            Step::Holding(file) => {
                state.removed_a_leftover |= state.files[file].named;
                state.files[file].named = false;
                state.files[file].lock = state.files[file].lock.filter(|&holder| holder != process);
                Step::Clear
            }
            Step::Create => {
                state.files.push(File { written: 0, on_disk: 0, lock: None, named: true, named_on_disk: false });
                Step::Created(state.files.len() - 1)
            }
            Step::Created(file) if self.is(Broken::FileNotLocked) => Step::Write(file),
            Step::Created(file) => match self.try_lock(state, file, process) {
                Some(false) => {
                    state.files[file].named = false;
                    Step::Create
                }
                Some(true) if !state.files[file].named && !self.is(Broken::NameNotChecked) => {
                    state.files[file].lock = None;
                    Step::Create
                }
                _ => Step::Write(file),
            },
            Step::Write(file) => {
                state.files[file].written = PART;
                if self.is(Broken::NamedBeforeItIsWhole) { Step::Name(file) } else { Step::Finish(file) }
            }
            Step::Finish(file) => {
                state.files[file].written = WHOLE;
                if self.is(Broken::NamedBeforeItIsOnDisk) { Step::Name(file) } else { Step::Sync(file) }
            }
            Step::Sync(file) => {
                state.files[file].on_disk = state.files[file].written;
                Step::Name(file)
            }
            Step::Name(file) => self.name(state, file),
            Step::Linked(file) => {
                state.files[file].named = false;
                Step::SyncFolder
            }
            Step::SyncFolder => {
                if !self.is(Broken::FolderNotSynced) {
                    state.published_on_disk = state.published;
                    state.files.iter_mut().for_each(|file| file.named_on_disk = file.named);
                }
                state.promised = true;
                Step::Done
            }
            step @ (Step::Clear | Step::Done | Step::Failed | Step::Dead) => step,
        };
        state.steps[process] = next;
        match next {
            Step::Done | Step::Failed => state.let_go(process),
            Step::SyncFolder => state.files.iter_mut().for_each(|file| file.lock = file.lock.filter(|&p| p != process)),
            _ => {}
        }
    }

    fn name(&self, state: &mut State, file: usize) -> Step {
        if !state.files[file].named {
            return Step::Failed;
        }
        if state.published.is_some() && !self.is(Broken::Replaces) {
            state.files[file].named = false;
            state.lost_a_race = true;
            return Step::SyncFolder;
        }
        state.published = Some(file);
        if self.links {
            return Step::Linked(file);
        }
        state.files[file].named = false;
        Step::SyncFolder
    }

    fn power_cut(state: &mut State, kept: u32) {
        let mut bits = (0..).map(|bit| kept >> bit & 1 == 1);
        let mut is_kept = || bits.next().unwrap_or(false);
        if !is_kept() {
            state.published = state.published_on_disk;
        }
        state.published_on_disk = state.published;
        for file in &mut state.files {
            if !is_kept() {
                file.named = file.named_on_disk;
            }
            if !is_kept() {
                file.written = file.on_disk;
            }
            (file.named_on_disk, file.on_disk, file.lock) = (file.named, file.written, None);
        }
        (state.folder_lock, state.reader, state.power_cut) = (None, None, true);
        // After the power cut, the first build is repeated.
        state.steps = [Step::Begin, Step::Dead, Step::Clear];
    }
}

impl Model for Protocol {
    type State = State;
    type Action = Action;

    fn init_states(&self) -> Vec<State> {
        vec![State {
            files: Vec::new(),
            published: None,
            published_on_disk: None,
            folder_lock: None,
            steps: [Step::Begin, Step::Begin, Step::Clear],
            reader: None,
            promised: false,
            killed: false,
            power_cut: false,
            removed_a_leftover: false,
            lost_a_race: false,
        }]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        for (process, step) in state.steps.into_iter().enumerate() {
            match step {
                Step::Done | Step::Failed | Step::Dead => continue,
                Step::Create if state.files.len() == MOST_FILES => {}
                Step::WaitForFolder if self.has_folder_lock() && state.folder_lock.is_some() => {}
                Step::Clear => {
                    let there = (0..state.files.len()).filter(|&file| state.files[file].named);
                    actions.extend(there.map(|file| Action::Open(process, file)));
                    if process != GC {
                        actions.push(Action::StopClearing(process));
                    }
                }
                _ => actions.push(Action::Step(process)),
            }
            if process != GC && !state.killed {
                actions.push(Action::Kill(process));
            }
        }
        if state.published.is_some() && state.published != state.reader {
            actions.push(Action::Read);
        }
        if !state.power_cut {
            actions.extend((0..1 << (1 + 2 * state.files.len())).map(Action::PowerCut));
        }
    }

    fn next_state(&self, last: &State, action: Action) -> Option<State> {
        let mut state = last.clone();
        match action {
            Action::Step(process) => self.step(&mut state, process),
            Action::Open(process, file) => state.steps[process] = Step::Opened(file),
            Action::StopClearing(process) => state.steps[process] = Step::Create,
            Action::Read => state.reader = state.published,
            Action::Kill(process) => {
                state.killed = true;
                state.end(process, Step::Dead);
            }
            Action::PowerCut(kept) => Self::power_cut(&mut state, kept),
        }
        (state != *last).then_some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        let mut properties = vec![
            Property::always("a final name refers to a whole file", |_, state: &State| {
                state.published.is_none_or(|file| state.files[file].written == WHOLE)
            }),
            Property::always("a final name refers to a file on disk", |_, state: &State| {
                state.published.is_none_or(|file| state.files[file].on_disk == WHOLE)
            }),
            Property::always("what a builder has made outlasts a power cut", |_, state: &State| {
                !state.promised || state.published.is_some()
            }),
            Property::always("what a reader has open stays the file of the name", |_, state: &State| {
                state.reader.is_none_or(|file| state.published == Some(file))
            }),
            Property::sometimes("both builders end well", |_, state: &State| {
                state.steps[..BUILDERS].iter().all(|step| *step == Step::Done)
            }),
            Property::sometimes("a rerun after a power cut ends well", |_, state: &State| {
                state.power_cut && state.promised && state.steps[0] == Step::Done
            }),
        ];
        if self.locks != Locks::Lying {
            properties
                .push(Property::always("no builder fails", |_, state: &State| !state.steps.contains(&Step::Failed)));
        }
        if self.locks != Locks::None {
            properties.push(Property::sometimes("a leftover is removed", |_, state: &State| state.removed_a_leftover));
        }
        if !self.has_folder_lock() {
            properties.push(Property::sometimes("a race is lost", |_, state: &State| state.lost_a_race));
        }
        properties
    }
}
